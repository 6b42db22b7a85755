"""Relation: whether an output walks at random, and inputs explain nothing of it beside its own past.

Two walks that have nothing to do with each other correlate (Granger & Newbold 1974, J. Econometrics 2(2)). Increments
given the past do not: Granger's test of causality (1969, Econometrica 37(3)), with squares of the inputs, since a law
may fold, over means of 1, 4, 16 and 64 samples, since noise hides slow answers in single ones. An answer after a dead
time, and one to products of inputs, stands out of the correlation of what is new in both (Haugh 1976, J. American
Statistical Association 71(354)), in its own spread, so that steps at the same times are no answer, and beside that with
inputs that come later, which no answer has.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np
from scipy.signal import correlate
from scipy.stats import f, norm

from hybrid_sysid_ros.extensions.shared.granger_causality import leads
from hybrid_sysid_ros.support.arrays import Array

SCALES, LAGS = (1, 4, 16, 64), 4
"""Samples of a mean, and past means that are regressors."""
CHANCE = 1e-3
"""Probability of as good an explanation by inputs that are unrelated, below which they are related."""
RANDOM = 0.8
"""Share of the increments that the past does not explain, from which they are random."""
ANSWER, CLEARLY = 0.01, 1.5
"""Probability of such a correlation by chance, and correlation with inputs that came before, in that with inputs that
come later, from which it is an answer.
"""
LEAST_SPREAD = 0.1
"""Least square of a correlation's spread, in that of even noise."""
FEWEST = 60
"""Fewest rows of a regression."""


def wanders(inputs: Array, output: Array) -> bool:
    """Whether an output (samples,) goes on at random at every time scale, whatever the inputs (samples, inputs)."""
    found = list(_explanations(inputs, output))
    random = bool(found) and all(unknown > RANDOM and chance > CHANCE for unknown, chance in found)
    return random and not answers(inputs, output, CHANCE**2)


def answers(inputs: Array, output: Array, chance: float = ANSWER) -> bool:
    """Whether what is new in an output (samples,) correlates with what was new before in an input (samples, inputs),
    its square, or a product of two, at any lag up to half of the record, beyond chance and beyond what comes later.
    """
    return any(
        before.max() > max(least, CLEARLY * after.max())
        for _, least, before, after in _correlations(inputs, output, chance)
    )


def is_early(inputs: Array, output: Array) -> bool:
    """Whether an output (samples,) moves before an input (samples, inputs) does: its past foretells the input, or what
    is new in it correlates with what comes later alone. The input of a feedback looks alike.
    """
    later = any(
        after.max() > max(least, CLEARLY * before.max())
        for _, least, before, after in _correlations(inputs, output, CHANCE**2)
    )
    return later or any(leads(output, values) for values in inputs.T)


def _correlations(inputs: Array, output: Array, chance: float) -> Iterator[tuple[int, float, Array, Array]]:
    """By time scale [samples] and cause, the correlation that chance reaches with so small a probability, those with
    what was new in the cause before (lags of 0 on), and those with what comes later (the last one is the next sample).
    """
    pairs = combinations_with_replacement(range(inputs.shape[1]), 2)
    causes = [*inputs.T, *(inputs[:, i] * inputs[:, k] for i, k in pairs)]
    for scale in SCALES:
        count = len(output) // scale
        if count - LAGS < FEWEST:
            return
        means = [values[: count * scale].reshape(count, scale).mean(axis=1) for values in (output, *causes)]
        y, *others = (_news(values) for values in means)
        longest = len(y) // 2
        least = float(norm.isf(chance / (2 * len(causes) * longest)))
        for cause in others:
            spread = np.maximum(correlate(y**2, cause**2, method="fft"), LEAST_SPREAD / len(y))
            at = np.abs(correlate(y, cause, method="fft")) / np.sqrt(spread)
            yield scale, least, at[len(y) - 1 : len(y) + longest], at[len(y) - 1 - longest : len(y) - 1]


def _news(values: Array) -> Array:
    """What a signal's own past does not say, of length 1; zeros where it says all."""
    moved = values - values.mean()
    own = np.column_stack([moved[LAGS - k : len(moved) - k] for k in range(1, LAGS + 1)])
    left = moved[LAGS:] - own @ np.linalg.lstsq(own, moved[LAGS:], rcond=1e-10)[0]
    size = float(np.linalg.norm(left))
    return np.asarray(left / size if size > 1e-9 * np.linalg.norm(moved) else 0.0 * left)


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
    found, _, rank, _ = np.linalg.lstsq(scaled, target, rcond=None)
    error = target - scaled @ found
    return float(error @ error), int(rank)
