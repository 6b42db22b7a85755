"""Inference: how rules of one Gaussian a variable fire, by the product or the least of their memberships.

Untuned Takagi-Sugeno rules of the plant of :mod:`.identification`, by level and drive, as publications have them: their
Gaussians are what fuzzy C-means tell of each variable, and least squares give the consequents. The models of this
project fire by distances of all variables at once instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.fuzzy.data import SEEDS, driven, training
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.fuzzy.clustering import fuzzy_c_means
from hybrid_sysid_ros.extensions.fuzzy.memberships import memberships
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

RULES = (3, 6, 15)
FIRING: Mapping[str, Callable[[Array], Array]] = {
    "product": lambda terms: np.prod(terms, axis=2),
    "least": lambda terms: np.min(terms, axis=2),
}
"""Of a rule, from the memberships of its variables (samples, rules, variables)."""


def error(rig: Rig, seed: int, rules: int, fire: Callable[[Array], Array]) -> float:
    """Root mean square error of the free run, as in the other tables."""
    record = training(rig.system, seed)
    rows = np.column_stack([record.outputs[:-1], record.inputs])
    scales = rows.std(axis=0)
    centres = fuzzy_c_means(rows / scales, rules, seed=seed) * scales
    parts = memberships(rows / scales, centres / scales, np.ones_like(centres)) ** 2
    away = (rows[:, None, :] - centres) ** 2
    widths = np.sqrt(np.einsum("ti,tij->ij", parts, away) / parts.sum(axis=0)[:, None])

    def regressors(points: Array) -> Array:
        fired = fire(np.exp(-0.5 * ((points[:, None, :] - centres) / widths) ** 2))
        shares = fired / fired.sum(axis=1, keepdims=True)
        affine = np.column_stack([np.ones(len(points)), points])
        return np.asarray((shares[:, :, None] * affine[:, None, :]).reshape(len(points), -1))

    consequents = np.linalg.lstsq(regressors(rows), record.outputs[1:, 0], rcond=None)[0]
    truth, level, found = simulate(rig.system, np.zeros(1), driven(), step=rig.step)[1:, 0], 0.0, []
    for u in driven()[:, 0]:
        level = float(regressors(np.array([[level, u]]))[0] @ consequents)
        found.append(level)
    return float(np.sqrt(np.mean((truth - np.array(found)) ** 2)))


def measured(rig: Rig) -> tuple[dict[str, Any], list[Table]]:
    """Both kinds of firing, of all seeds."""
    found: dict[str, Any] = {}
    table = Table("rules", "fire by", "mean", "least", "largest", title="error of the free run, not tuned, 3 seeds")
    for rules in RULES:
        for name, fire in FIRING.items():
            values = result.spread([error(rig, seed, rules, fire) for seed in SEEDS])
            found[f"{rules} rules, {name}"] = values
            table.add_row(str(rules), name, *(f"{value:.2g}" for value in values.values()))
    return found, [table]
