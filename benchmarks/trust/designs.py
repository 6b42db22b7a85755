"""Designed experiments against those of the rig: variances of fitted parameters over sensor noises.

A run lasts at most a quarter of an hour; the next one goes on from ``results/trust_designs.part.json``, with the
experiments in ``results/trust_designs.part``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks import result
from benchmarks.resumed import digest, resumed
from benchmarks.trust.intervals import CODE, true_rig
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.experiment_design.design import designed
from hybrid_sysid_ros.extensions.experiment_design.plan_folder import SIGNALS, save_plan
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.context import Context
from hybrid_sysid_ros.library.arguments import given_sampling
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.experiments import excitation, simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.signal_file import driving_columns, write_signals

RIGS = {"cam_beam": 200.0, "flexible_joint": 200.0, "wheel_motor": 100.0}
"""Samples per second [Hz] by rig."""
DESIGNED, OTHERS = "designed", ("multisine", "random_steps", "swept_sine")
FIRST = 10.0
"""Length of the multisine from which the first model is [s]."""
SECONDS, RATE = 60.0, 100.0
"""Length of an experiment [s], and samples of a designed drive per second [Hz]."""
NOISES, FIRST_SEED = 20, 8000
MOST = 0.5
"""What is asked of the ratio of the worst variances."""
PART = result.RESULTS / "trust_designs.part.json"
PLANS = result.RESULTS / "trust_designs.part"


def counted(rig: Rig) -> list[str]:
    """The parameters that data alone determine: a prior would keep one where a poor experiment says nothing of it."""
    return [item.name for item in rig.system.parameters if not item.fixed and item.spread is None]


def recorded(rig: Rig, kind: str, *, seed: int, seconds: float) -> Record:
    """A simulated experiment."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / "bag"
        simulate_experiment(rig, kind, place, seed=seed, duration=seconds, rate=RIGS[rig.name])
        return bags.read(place, rig.signals)


@cache
def first_model(name: str) -> Model:
    """What is known before the experiment: a gray box of ten seconds."""
    rig, sampling = true_rig(name), given_sampling(None, true_rig(name))
    record = recorded(rig, OTHERS[0], seed=FIRST_SEED - 1, seconds=FIRST)
    return identify([record], rig, "gray", sampling=sampling, refine=True)


def fitted(rig: Rig, record: Record) -> System:
    """A gray box of one record, searched from the first model on: from the declared values a search in short rollouts
    may end in another minimum of the whole record, so that the variance would be that of the search.
    """
    first = first_model(rig.name)
    context = Context(rig=rig, sampling=first.sampling, options=first.fit["options"], seed=0, records=[record])
    held = [item.name for item in first.system.parameters if not item.fixed and item.name not in first.names]
    return context.fit_physics([first.system], stages=(None,), hold=held, starts=1, again=True).system


def played(name: str, kind: str, folder: Path) -> Path:
    """A file that plays an experiment of the rig with the same signals under every noise; made where it is missing."""
    place = folder / name / kind
    if kind == DESIGNED and not place.exists():
        planned(name, folder)
    elif not place.exists():
        rig = true_rig(name)
        times = np.arange(round(SECONDS / rig.step) + 1, dtype=np.float64) * rig.step
        driving = excitation(rig, kind, seed=FIRST_SEED, duration=SECONDS, times=times)
        scales = np.ones(driving.shape[1])
        for index, loop in rig.experiments.loops.items():
            scales[index] = rig.sensors[loop.output].scale
        place.mkdir(parents=True)
        write_signals(place / SIGNALS, times, dict(zip(driving_columns(rig), (driving / scales).T, strict=True)))
    return place / SIGNALS


def planned(name: str, folder: Path) -> dict[str, float]:
    """Design the experiment, and say how many seconds of a processor that takes: machines are busy."""
    model, rig = first_model(name), true_rig(name)
    begun = time.process_time()
    found = designed(model, rig, seconds=SECONDS, period=1.0 / RATE, parameters=counted(rig))
    seconds = time.process_time() - begun
    (folder / name).mkdir(parents=True, exist_ok=True)
    save_plan(folder / name / DESIGNED, found)
    return {"seconds": seconds, **dict(zip(found.names, found.after.tolist(), strict=True))}


def errors(name: str, kind: str, folder: Path, seed: int) -> dict[str, float]:
    """Errors of the parameters, in the larger one of value and scale, of one record."""
    rig = true_rig(name)
    file = played(name, kind, folder)
    values = fitted(rig, recorded(rig, str(file), seed=seed, seconds=SECONDS)).named
    truth = rig.system.named
    sizes = {item.name: max(abs(truth[item.name]), item.scale) for item in rig.system.parameters}
    return {key: (values[key] - truth[key]) / sizes[key] for key in counted(rig)}


def tasks(folder: Path) -> Iterator[tuple[str, str, Any]]:
    """The designs, and all records of all experiments."""
    for name in RIGS:
        yield name, "design", partial(planned, name, folder)
    for seed in range(FIRST_SEED, FIRST_SEED + NOISES):
        for name in RIGS:
            for kind in (DESIGNED, *OTHERS):
                yield f"{name} {kind}", str(seed), partial(errors, name, kind, folder, seed)


def measured() -> dict[str, Any]:
    """By rig: the worst parameter's variance of each experiment, their ratio, the noises, and a design's seconds."""
    code = digest(*CODE)
    done = resumed(PART, tasks(PLANS / code[:12]), code)
    found = {}
    for name in RIGS:
        runs = {kind: list(done.get(f"{name} {kind}", {}).values()) for kind in (DESIGNED, *OTHERS)}
        fewest = min(map(len, runs.values()))
        if fewest >= 2:
            worst = {kind: _worst(items[:fewest]) for kind, items in runs.items()}
            least = min(worst[kind][1] for kind in OTHERS)
            found[name] = {
                "noises": fewest,
                "ratio": worst[DESIGNED][1] / least,
                "worst": {kind: {"parameter": key, "variance": value} for kind, (key, value) in worst.items()},
                "seconds": done[name]["design"]["seconds"],
            }
    return found


def _worst(runs: Sequence[dict[str, float]]) -> tuple[str, float]:
    variances = {key: float(np.var([run[key] for run in runs], ddof=1)) for key in runs[0]}
    return max(variances.items(), key=lambda item: item[1])
