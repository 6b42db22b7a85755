"""Four gray boxes of a drill string under a hand on its brake, and the lecture's three steps.

Fit a gray box; test whether what it leaves is random; if not, fit a black box to it: the hybrid. None of them is told
of the brake. Learnt from the first halves of two braked records, scored by the strict free run of the bit's speed on
their second halves, as a whole and within the stick phases: half a second around every sample in which the bit stands.
The ensemble is the mean of the four simulations.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.search.cross_validation import cross_validate
from hybrid_sysid_ros.extensions.shared.residual_tests import correlation_tests
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation.scores import free_run
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BOXES = ("coulomb", "stribeck", "dahl", "hysteretic")
RECORDS = ("braked_random_steps", "braked_slow_steps")
BIT = 0
SAMPLING = Sampling(step=0.005, period=0.02)
TRAINING, UNSEEN = Part(stop=0.5), Part(start=0.5)
SEEDS = (0, 1, 2)
STANDS, AROUND = 0.08, 0.5
"""Measured speed of a bit that stands [rad/s], four deviations of the noise, and seconds about it."""
CANDIDATES: tuple[tuple[str, dict[str, float]], ...] = (
    ("residual", {}),
    ("residual", {"output_lags": 1, "ridge": 3.0}),
    ("residual", {"units": 0, "degree": 2}),
    ("hybrid", {"everywhere": 1}),
    ("hybrid", {"everywhere": 1, "scale": 1.0}),
    ("hybrid", {"everywhere": 1, "scale": 1.0, "ridge": 1.0}),
    ("hybrid", {"everywhere": 1, "scale": 1.0, "ridge": 1.0, "units": 8}),
)
"""Kinds of hybrids and their options: those of the largest score of blocked cross-validation within the training halves
are taken, about Stribeck's box with seed 0. One that does not die away in free run is refused, and out."""


def stick_phases(speed: Array) -> NDArray[np.bool_]:
    """Where the bit stands or has or will within AROUND, (samples,)."""
    reach = round(AROUND / SAMPLING.period)
    window = np.ones(2 * reach + 1)
    return np.asarray(np.convolve(np.abs(speed) < STANDS, window, mode="same") > 0.5)


def errors(system: System, records: Mapping[str, Record]) -> tuple[list[Array], list[Array], list[Array]]:
    """Of each unseen half: the bit's simulated and measured speed, and all inputs at the samples."""
    simulated, measured, inputs = [], [], []
    for record in records.values():
        experiment = prepare(UNSEEN.of(record, SAMPLING), system, SAMPLING)
        simulated.append(free_run(system, experiment)[:, BIT])
        measured.append(experiment.outputs[:, BIT])
        inputs.append(experiment.inputs[:: SAMPLING.every][: experiment.samples])
    return simulated, measured, inputs


def judged(simulated: list[Array], measured: list[Array]) -> dict[str, float]:
    """Root mean square error [rad/s] and R2, of all and of the stick phases."""
    found, truth = np.concatenate(simulated), np.concatenate(measured)
    sticks = np.concatenate([stick_phases(speed) for speed in measured])
    error = found - truth
    return {
        "r2": float(1.0 - np.sum(error**2) / np.sum((truth - truth.mean()) ** 2)),
        "rmse": float(np.sqrt(np.mean(error**2))),
        "stick_rmse": float(np.sqrt(np.mean(error[sticks] ** 2))),
        "stick_share": float(np.mean(sticks)),
    }


def measured(rig: Rig) -> dict[str, Any]:
    """The three steps with each box, and their ensemble."""
    folder = Path(__file__).parents[2] / "bags"
    records = {name: bags.read(folder / f"{rig.name}_{name}", rig.signals) for name in RECORDS}
    learnt = [*records.values()]
    given: dict[str, Any] = {"sampling": SAMPLING, "part": TRAINING}
    choice: list[dict[str, Any]] = []
    for kind, options in CANDIDATES:
        try:
            found = cross_validate(learnt, rig, f"{kind}_stribeck", **given, options=options)
        except UserError as error:
            choice.append({"kind": kind, "options": options, "r2": -1e9, "refused": str(error)})
            continue
        choice.append({"kind": kind, "options": options, "r2": found.value, "standard_error": found.standard_error})
    best = max(choice, key=lambda item: float(item["r2"]))
    kind, chosen = best["kind"], best["options"]
    rows: dict[str, Any] = {}
    grays: list[list[Array]] = []
    hybrids: list[list[list[Array]]] = [[] for _ in SEEDS]
    truth: list[Array] = []
    for box in BOXES:
        model = identify(learnt, rig, box, **given)
        gray, truth, inputs = errors(model.system, records)
        grays.append(gray)
        left = [
            truly[:-1] - found[:-1] for truly, found in zip(truth, gray, strict=True)
        ]  # its last sample has no input
        tests = correlation_tests(np.concatenate(left), np.concatenate(inputs)[:, 0])
        runs, seconds = [], []
        for seed, kept in zip(SEEDS, hybrids, strict=True):
            better = identify(learnt, rig, f"{kind}_{box}", **given, options=chosen, seed=seed)
            run = errors(better.system, records)[0]
            kept.append(run)
            runs.append(judged(run, truth))
            seconds.append(better.fit["seconds"])
        rows[box] = {
            "gray": judged(gray, truth),
            "random": {name: test.passed for name, test in tests.items()},
            "hybrid": {key: result.spread([run[key] for run in runs]) for key in ("r2", "rmse", "stick_rmse")},
            "seconds": {"gray": model.fit["seconds"], "hybrid": result.spread(seconds)},
        }
    means = [judged([np.mean(parts, axis=0) for parts in zip(*kept, strict=True)], truth) for kept in hybrids]
    rows["ensemble"] = {
        "gray": judged([np.mean(parts, axis=0) for parts in zip(*grays, strict=True)], truth),
        "hybrid": {key: result.spread([mean[key] for mean in means]) for key in ("r2", "rmse", "stick_rmse")},
    }
    return {"choice": choice, "kind": kind, "chosen": chosen, "structures": rows}


def tables(found: Mapping[str, Any]) -> list[Table]:
    """Errors of gray boxes and hybrids, and which tests of randomness the gray boxes pass."""
    shown = Table(
        "", "gray: R2", "RMSE", "in stick phases", "tests passed", "hybrid: R2", "RMSE", "in stick phases",
        title="unseen halves: free run of the bit's speed [rad/s]",
    )  # fmt: skip
    for name, row in found["structures"].items():
        passed = f"{sum(row['random'].values())} of {len(row['random'])}" if "random" in row else ""
        shown.add_row(
            name,
            *(f"{row['gray'][key]:.3f}" for key in ("r2", "rmse", "stick_rmse")),
            passed,
            *(_shown(row["hybrid"][key]) for key in ("r2", "rmse", "stick_rmse")),
        )
    return [shown]


def _shown(values: Mapping[str, float]) -> str:
    return f"{values['mean']:.3f} ({values['min']:.3f}-{values['max']:.3f})"
