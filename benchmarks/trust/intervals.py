"""Standard errors of parameters: how often their 90 % intervals hold the truth, over many simulated experiments.

A run lasts at most a quarter of an hour; the next one goes on from ``results/trust_intervals.part.json``, unless the
package has changed since.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks import result
from benchmarks.resumed import digest, resumed
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.library.arguments import given_sampling
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig, load

RIGS = {"cam_beam": 1000.0, "wheel_motor": 100.0}
"""Samples per second [Hz] by rig."""
CODE = tuple(
    f"hybrid_sysid_ros/{room}"
    for room in ("core", "models", "identification", "structures", "rigs", "extensions/experiment_design")
)
"""What sets the results."""
EXPERIMENTS, SECONDS = ("multisine", "random_steps"), 20.0
FINER = 4
"""Parts of the rig's own step in which it is simulated."""
REPETITIONS = 60
FIRST_SEED = 5000
LEVEL = 0.9
WITHIN = (0.85, 0.95)
PART = result.RESULTS / "trust_intervals.part.json"


def true_rig(name: str) -> Rig:
    """A rig that its own law can be true to: without a bias of its inputs, and without ends of the identified range,
    which each fit takes from its records; simulated at a finer step than any fit takes, since a law has none.
    """
    rig = load(name)
    rig = replace(rig, step=rig.step / FINER)
    nodes = {**rig.content.get("nodes", {})}
    nodes["plant"] = {**nodes.get("plant", {}), "bias": [0.0] * len(rig.actuators)}
    ends = {
        item.name: item.low if item.name.endswith("low") else item.high for item in rig.system.parameters if item.fixed
    }
    values = [ends.get(key, value) for key, value in rig.system.named.items()]
    return replace(rig, system=rig.system.with_values(values), content={**rig.content, "nodes": nodes})


def records_of(rig: Rig, seed: int) -> list[Record]:
    """An experiment of each kind."""
    found = []
    with TemporaryDirectory() as folder:
        for kind in EXPERIMENTS:
            place = Path(folder) / f"{kind}_{seed}"
            simulate_experiment(rig, kind, place, seed=seed, duration=SECONDS, rate=RIGS[rig.name])
            found.append(bags.read(place, rig.signals))
    return found


def deviations(rig: Rig, seed: int) -> dict[str, float]:
    """Errors of the parameters in their standard errors, fitted as the command and the library do by default."""
    model = identify(records_of(rig, seed), rig, "gray", sampling=given_sampling(None, rig), refine=True)
    truth, values = rig.system.named, model.system.named
    return {name: (values[name] - truth[name]) / error for name, error in model.standard_errors.items()}


def measured() -> dict[str, Any]:
    """By rig, the share of intervals that hold the truth of each parameter, of the repetitions that are done."""
    seeds = [str(seed) for seed in range(FIRST_SEED, FIRST_SEED + REPETITIONS)]
    tasks = ((name, seed, partial(deviations, true_rig(name), int(seed))) for seed in seeds for name in RIGS)
    done = resumed(PART, tasks, digest(*CODE))
    return {name: coverage(list(runs.values())) for name, runs in done.items()}


def coverage(runs: list[dict[str, float]]) -> dict[str, Any]:
    """Shares of intervals that hold the truth, by parameter, and the mean of all."""
    bound = float(norm.ppf(0.5 + 0.5 * LEVEL))
    names = runs[0] if runs else {}
    errors = {name: np.array([run[name] for run in runs]) for name in names}
    shares = {name: float(np.mean(np.abs(values) <= bound)) for name, values in errors.items()}
    return {
        "repetitions": len(runs),
        "held": shares,
        "all": float(np.mean(list(shares.values()))) if shares else 0.0,
        "bias": {name: float(np.mean(values)) for name, values in errors.items()},
        "spread": {name: float(np.std(values)) for name, values in errors.items()},
    }
