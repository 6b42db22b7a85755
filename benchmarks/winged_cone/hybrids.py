"""Hybrids on the coefficients beside each single method: physics, network, fuzzy and fuzzy-neural rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.winged_cone import flights
from benchmarks.winged_cone.identification import HORIZONS, MANOEUVRES, fitted, scores
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.arrays import Array

KEPT = Path("out/winged_cone_hybrids")
"""Where finished fits are kept until the end."""
NETWORK, RULES, LINKED = {"units": 8}, {"affine_rules": 4}, {"linked_rules": 15}
ALONE = {"everywhere": 1}
"""On all rates of a linear system, which is fitted with it: no physics."""
METHODS: Mapping[str, tuple[str, Options]] = {
    "P0": ("constant_air", {}),
    "P1": ("known_air", {}),
    "network": ("hybrid_joint", {**NETWORK, **ALONE}),
    "Takagi-Sugeno": ("hybrid_joint", {"affine_rules": 3, **ALONE}),
    "DIFNN": ("hybrid_joint", {"linked_rules": 12, **ALONE}),
    "P1 + network": ("hybrid_known_air", NETWORK),
    "P1 + Takagi-Sugeno": ("hybrid_known_air", RULES),
    "P1 + DIFNN": ("hybrid_known_air", LINKED),
    "P0 + Takagi-Sugeno": ("hybrid_constant_air", RULES),
}
"""Structure and options, chosen before any manoeuvre was flown. Alone, two of four affine or of fifteen linked rules
have the same cluster in the record of some plant, so there are fewer.
"""
SINGLE = ("P1", "network", "Takagi-Sugeno", "DIFNN")
HYBRID = tuple(name for name in METHODS if name.startswith("P1 +"))
PLANTS, SEEDS = (0, 1, 2), (0, 1, 2)
QUICK = ("P0", "P1", "P1 + network", "P1 + Takagi-Sugeno")
"""On all plants and seeds; of the others each plant has one seed, for their fits take minutes."""
KEYS = (*HORIZONS, "CL")


def run(item: tuple[str, int, int]) -> dict[str, Array]:
    """One method on one plant by the record of one seed: the record's commands and noise, and where its fit begins."""
    method, plant, seed = item
    rig, (structure, options) = load(flights.RIG), METHODS[method]
    truth = flights.plant(rig.system, 100 + plant)
    model, deviation = fitted(rig, truth, structure, seed, options)
    found = scores(model.system, rig, truth, deviation)
    return {
        "fit": np.array([model.free_numbers, model.fit["chi_squared"], model.fit["seconds"]]),
        "scores": np.array([[found[manoeuvre][key] for key in KEYS] for manoeuvre in MANOEUVRES]),
    }


def measured(rig: Rig) -> dict[str, Any]:
    """All methods on plants and seeds; an interrupted run goes on from its finished fits."""
    items = [(name, p, s) for name in METHODS for p in PLANTS for s in SEEDS if name in QUICK or p == s]
    store: parallel.Store[dict[str, Array]] = parallel.Store(
        KEPT, f"{rig.system} {rig.content['experiments']} {METHODS}"
    )
    found = parallel.run(run, items, store=store)
    store.remove()
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in METHODS}
    for (name, plant, seed), arrays in zip(items, found, strict=True):
        numbers, chi_squared, seconds = arrays["fit"].tolist()
        errors = {
            manoeuvre: dict(zip(KEYS, row, strict=True))
            for manoeuvre, row in zip(MANOEUVRES, arrays["scores"].tolist(), strict=True)
        }
        runs[name].append(
            {
                "plant": plant,
                "seed": seed,
                "numbers": round(numbers),
                "chi_squared": chi_squared,
                "seconds": seconds,
                "scores": errors,
            }
        )
    return summary(runs)


Runs = Mapping[str, Sequence[Mapping[str, Any]]]
"""By method."""


def summary(runs: Runs) -> dict[str, Any]:
    """Errors over the runs of each method, and what each hybrid takes off."""
    return {
        "runs": runs,
        "errors": {
            name: {
                manoeuvre: {key: result.spread([item["scores"][manoeuvre][key] for item in found]) for key in KEYS}
                for manoeuvre in MANOEUVRES
            }
            for name, found in runs.items()
        },
        "chi_squared": {name: result.spread([item["chi_squared"] for item in found]) for name, found in runs.items()},
        "over_best_single": {name: _over(runs, name, SINGLE) for name in HYBRID},
        "over_physics": {name: _over(runs, name, ("P1",)) for name in HYBRID},
    }


def _over(runs: Runs, name: str, others: Sequence[str]) -> dict[str, dict[str, dict[str, float]]]:
    """A method's errors in those of the best other of the same plant and seed, by manoeuvre and horizon, over the
    plants and seeds that all of them have.
    """
    by_pair = {
        method: {(item["plant"], item["seed"]): item["scores"] for item in runs[method]} for method in (name, *others)
    }
    pairs = set.intersection(*(set(found) for found in by_pair.values()))

    def ratios(manoeuvre: str, key: str) -> list[float]:
        return [
            by_pair[name][pair][manoeuvre][key] / min(by_pair[other][pair][manoeuvre][key] for other in others)
            for pair in sorted(pairs)
        ]

    return {manoeuvre: {key: result.spread(ratios(manoeuvre, key)) for key in KEYS} for manoeuvre in MANOEUVRES}


def tables(found: Mapping[str, Any]) -> list[Table]:
    """Errors of each method by horizon, and hybrids over the best single method and over the physics."""
    shown = []
    for key in KEYS:
        table = Table("", *MANOEUVRES, title=f"{key}: errors in training deviations, mean (range)")
        for name, rows in found["errors"].items():
            table.add_row(name, *(reported(rows[manoeuvre][key]) for manoeuvre in MANOEUVRES))
        shown.append(table)
    for over, title in (("over_best_single", "the best single method of the same run"), ("over_physics", "P1")):
        for name, rows in found[over].items():
            table = Table("", *MANOEUVRES, title=f"{name}: errors over those of {title}, mean (range)")
            for key in KEYS:
                table.add_row(key, *(reported(rows[manoeuvre][key]) for manoeuvre in MANOEUVRES))
            shown.append(table)
    table = Table("", "numbers", "chi2", "seconds", title="fits, mean (range)")
    for name, runs in found["runs"].items():
        seconds = np.mean([item["seconds"] for item in runs])
        table.add_row(name, str(runs[0]["numbers"]), reported(found["chi_squared"][name]), f"{seconds:.0f}")
    return [*shown, table]


def reported(value: Mapping[str, float]) -> str:
    """A spread."""
    return f"{value['mean']:.3g} ({value['min']:.2g}-{value['max']:.2g})"
