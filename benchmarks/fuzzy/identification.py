"""Takagi-Sugeno models of y(k + 1) = y(k) / (1 + y(k)^2) + u(k): untuned, by chosen premises, tuned, under noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.fuzzy.data import DRIVE, LEVEL, SEEDS, free_run_error, training
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.fuzzy.rule_selection import select_rules
from hybrid_sysid_ros.extensions.fuzzy.tuning import tuned
from hybrid_sysid_ros.rigs.rig import Rig

BOTH = (0, 1)
"""Premises of level and drive."""
CASES: Mapping[str, tuple[dict[str, Any], float, bool, float | None]] = {
    "6 rules, both premises": ({"rules": 6, "premises": BOTH}, 0.0, False, 0.05),
    "15 rules, both premises": ({"rules": 15, "premises": BOTH}, 0.0, False, 0.022),
    "6 rules, both premises, Gustafson-Kessel": (
        {"rules": 6, "premises": BOTH, "ellipsoids": True}, 0.0, False, None,
    ),
    "6 rules, chosen premises": ({"rules": 6}, 0.0, False, 0.008),
    "3 rules, chosen premises, tuned": ({"rules": 3}, 0.0, True, 1e-3),
    "6 rules, chosen premises, tuned": ({"rules": 6}, 0.0, True, 2e-4),
    "6 rules, both premises, tuned": ({"rules": 6, "premises": BOTH}, 0.0, True, None),
    "grown, tuned": ({}, 0.0, True, None),
    "noise .05: 6 rules, both premises": ({"rules": 6, "premises": BOTH}, 0.05, False, None),
    "noise .05: 6 rules, chosen premises": ({"rules": 6}, 0.05, False, None),
    "noise .05: 6 rules, chosen premises, tuned": ({"rules": 6}, 0.05, True, 0.015),
    "noise .05: grown, tuned": ({}, 0.05, True, None),
}  # fmt: skip
"""What is chosen, the noise, whether it is tuned, and the error that is asked."""


def model(plant: System, seed: int, options: Mapping[str, Any], *, noise: float, tune: bool) -> Any:
    """A model from the record of a seed."""
    record = training(plant, seed, noise=noise)
    chosen = select_rules([record], outputs=[LEVEL], inputs=[DRIVE], output_lags=1, input_lags=1, seed=seed, **options)
    return tuned(chosen, [record]).system if tune else chosen


def measured(rig: Rig) -> tuple[dict[str, Any], list[Table]]:
    """Errors of the free run, of all cases and seeds."""
    found: dict[str, Any] = {}
    table = Table("model", "asked", "mean", "least", "largest", "rules", title="error of the free run, 3 seeds")
    for name, (options, noise, tune, asked) in CASES.items():
        models = [model(rig.system, seed, options, noise=noise, tune=tune) for seed in SEEDS]
        errors = result.spread([free_run_error(rig.system, item) for item in models])
        rules = [item.rules for item in models]
        found[name] = {**errors, "asked": asked, "rules": rules, "premises": [item.premises for item in models]}
        numbers = (f"{value:.2g}" for value in errors.values())
        table.add_row(name, "" if asked is None else f"{asked:g}", *numbers, ", ".join(map(str, rules)))
    return found, [table]
