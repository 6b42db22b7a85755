"""Fuzzy predictive control beside that by the exact model: the same horizon, weights and feedback correction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks import result
from benchmarks.fuzzy.data import SEEDS, STEP
from benchmarks.fuzzy.identification import model
from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System, one_step
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

PROBLEM = ControlProblem(
    horizon=5,
    period=STEP,
    substeps=1,
    output_weights=(1.0,),
    rate_weights=(0.01,),
    input_low=(-1.5,),
    input_high=(1.5,),
)
SAMPLES, CORRECTION = 300, 0.5
OFFSET, FROM, NOISE = 0.2, 75, 0.02
MODELS: dict[str, dict[str, Any]] = {
    "6 rules, both premises": {"rules": 6, "premises": (0, 1)},
    "15 rules, both premises": {"rules": 15, "premises": (0, 1)},
    "6 rules, chosen premises": {"rules": 6},
}


def reference(k: NDArray[np.int64]) -> Array:
    """A square wave of 25 samples a level for 150 samples, then a sine."""
    square = np.where(k // 25 % 2 == 0, 1.0, -1.0)
    return np.where(k < 150, square, 1.2 * np.sin(2.0 * np.pi * k / 50.0))


def error(plant: System, system: System, *, disturbed: bool, corrected: bool, seed: int) -> float:
    """Root mean square tracking error of the plant's output, an offset of which comes in the middle."""
    controller, random = ExactMpc(system, PROBLEM), np.random.default_rng(100 + seed)
    x, u, correction, expected, errors = np.zeros(1), np.zeros(1), 0.0, 0.0, []
    for k in range(SAMPLES):
        offset = OFFSET if disturbed and k >= FROM else 0.0
        reading = x[0] + offset + (NOISE * random.normal() if disturbed else 0.0)
        if corrected and k:
            correction += CORRECTION * (reading - expected - correction)
        if k:  # the first one is nobody's choice
            errors.append(x[0] + offset - reference(np.array(k)))
        preview = reference(k + np.arange(1, PROBLEM.horizon + 1)) - correction
        seen = np.array([reading - correction])
        u = controller.control(seen, np.zeros(1), u, preview[:, None]).input
        expected = float(one_step(system, seen, u, step=STEP)[0])
        x = one_step(plant, x, u, step=STEP)
    return float(np.sqrt(np.mean(np.square(errors))))


def measured(rig: Rig) -> tuple[dict[str, Any], list[Table]]:
    """Tracking errors of all models and seeds, and those by the exact model."""
    found: dict[str, Any] = {}
    table = Table(
        "model in the controller", "undisturbed", "offset and noise", "over the exact model", "without correction",
        title="tracking error, mean of 3 seeds",
    )  # fmt: skip
    cases = {"undisturbed": (False, True), "disturbed": (True, True), "without correction": (True, False)}
    untuned: dict[str, list[System]] = {
        name: [model(rig.system, seed, options, noise=0.0, tune=False) for seed in SEEDS]
        for name, options in MODELS.items()
    }
    tuned = [model(rig.system, seed, {"rules": 6}, noise=0.0, tune=True) for seed in SEEDS]
    systems = {"exact model": [rig.system] * len(SEEDS), **untuned, "6 rules, chosen premises, tuned": tuned}
    for name, models in systems.items():
        found[name] = {
            case: result.spread(
                [
                    error(rig.system, item, disturbed=disturbed, corrected=corrected, seed=seed)
                    for seed, item in zip(SEEDS, models, strict=True)
                ]
            )
            for case, (disturbed, corrected) in cases.items()
        }
        row = {case: values["mean"] for case, values in found[name].items()}
        found[name]["ratio"] = row["disturbed"] / found["exact model"]["disturbed"]["mean"]
        table.add_row(
            name, f"{row['undisturbed']:.4f}", f"{row['disturbed']:.4f}", f"{found[name]['ratio']:.2f}",
            f"{row['without correction']:.3f}",
        )  # fmt: skip
    return found, [table]
