"""Relation: whether an output walks at random, and inputs explain nothing of it beside its own past.

Two walks that have nothing to do with each other correlate (Granger & Newbold 1974, J. Econometrics 2(2)). Increments
given the past do not: Granger's test of causality (1969, Econometrica 37(3)), with squares of the inputs, since a law
may fold, over means of 1, 4, 16 and 64 samples, since noise hides slow answers in single ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.stats import f

from hybrid_sysid_ros.support.arrays import Array

SCALES, LAGS = (1, 4, 16, 64), 4
"""Samples of a mean, and past means that are regressors."""
CHANCE = 1e-3
"""Probability of as good an explanation by inputs that are unrelated, below which they are related."""
RANDOM = 0.8
"""Share of the increments that the past does not explain, from which they are random."""
FEWEST = 60
"""Fewest rows of a regression."""


def wanders(inputs: Array, output: Array) -> bool:
    """Whether an output (samples,) goes on at random at every time scale, whatever the inputs (samples, inputs)."""
    found = list(_explanations(inputs, output))
    return bool(found) and all(unknown > RANDOM and chance > CHANCE for unknown, chance in found)


def _explanations(inputs: Array, output: Array) -> Iterator[tuple[float, float]]:
    """By time scale, the share of the increments that the past leaves, and the probability of what the inputs explain
    of them if they are unrelated.
    """
    for scale in SCALES:
        count = len(output) // scale
        if count - LAGS < FEWEST:
            return
        u, y = (item[: count * scale].reshape(count, scale, -1).mean(axis=1) for item in (inputs, output))
        u = (u - u.mean(axis=0)) / np.maximum(u.std(axis=0), 1e-300)
        own = [np.ones(count - LAGS), *(y[LAGS - k : count - k, 0] for k in range(1, LAGS + 1))]
        causes = [cause[LAGS - k : count - k] for cause in np.column_stack([u, u**2]).T for k in range(LAGS + 1)]
        target = y[LAGS:, 0] - y[LAGS - 1 : -1, 0]
        (alone, fewer), (left, rank) = (_explained(np.column_stack(columns), target) for columns in (own, own + causes))
        more, free = max(rank - fewer, 1), len(target) - rank
        whole = float(np.sum((target - target.mean()) ** 2))
        yield alone / max(whole, 1e-300), float(f.sf((alone - left) / more / max(left / free, 1e-300), more, free))


def _explained(columns: Array, target: Array) -> tuple[float, int]:
    """Sum of squares that columns leave of a target, and their rank."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    found, _, rank, _ = np.linalg.lstsq(scaled, target)
    error = target - scaled @ found
    return float(error @ error), int(rank)
