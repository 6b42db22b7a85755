"""Shots: how often 90 % intervals hold the truth, over coordinates, live shots and what is declared of a simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from benchmarks.meaning.rows import Row
from hybrid_sysid_ros.extensions.accuracy.statistics import Discrepancy, NormalInverseWishart
from hybrid_sysid_ros.support.arrays import Array

REPETITIONS, LEVEL, CORRELATION = 10_000, 0.9, 0.3
COORDINATES, LIVE, SIMULATED = (1, 2, 3, 4, 8), (5, 10, 20), (50, 200)
MEANS, SPREADS = (0.0, 0.5, 1.0), (0.0, 0.1, 0.2, 0.3, 0.35)
ASKED = 0.02
"""Largest distance of a coverage from LEVEL."""


def coverage(d: int, live: int, simulated: int, declared: Discrepancy) -> dict[str, float]:
    """Of the intervals of mean and spread, of a simulation that is off as it was declared, and of live shots alone."""
    generator = np.random.default_rng((d, live, simulated))
    root = np.linalg.cholesky(CORRELATION + (1.0 - CORRELATION) * np.eye(d))

    def normal(count: int) -> Array:
        return np.asarray(generator.standard_normal((REPETITIONS, count, d)) @ root.T)

    nothing = NormalInverseWishart.reference(d)
    factor = np.exp(declared.spread * generator.standard_normal((REPETITIONS, d)))
    offset = factor * declared.mean * normal(1)[:, 0]
    prior = declared.weaken(nothing.updated(normal(simulated)))
    shots = offset[:, None, :] + factor[:, None, :] * normal(live)
    found = {}
    for name, posterior in (
        ("together", prior.updated(shots)),
        ("live alone", nothing.updated(shots).of_each_alone),
    ):
        for what, (low, high), true in (
            ("mean", posterior.mean_interval(LEVEL), offset),
            ("spread", posterior.spread_interval(LEVEL), factor),
        ):
            found[f"{what}, {name}"] = float(np.mean((low <= true) & (true <= high)))
    return found


def measured() -> tuple[Mapping[str, Any], list[Row]]:
    """The table, and the coverage that is farthest from its level, for each number of coordinates."""
    table: dict[str, dict[str, float]] = {}
    worst: dict[int, float] = dict.fromkeys(COORDINATES, 0.0)
    for d, live, simulated, mean, spread in product(COORDINATES, LIVE, SIMULATED, MEANS, SPREADS):
        if live > d:
            values = coverage(d, live, simulated, Discrepancy(mean=mean, spread=spread))
            table[f"d {d}, live {live}, simulated {simulated}, mean {mean:g}, spread {spread:g}"] = values
            worst[d] = max(worst[d], *(abs(value - LEVEL) for value in values.values()))
    rows = [
        Row(name=f"farthest coverage from .9, {d} coordinates", asked=ASKED, measured=value, at_most=True)
        for d, value in worst.items()
        if math.isfinite(value)
    ]
    return {"repetitions": REPETITIONS, "coverage": table}, rows
