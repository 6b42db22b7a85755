"""First equation: the dead times and the linear equation of second order that are nearest to a record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from hybrid_sysid_ros.support.arrays import Array

CONSTANTS, DAMPINGS = np.geomspace(1.0 / 60.0, 3.0, 24), np.array([0.05, 0.2, 0.5, 1.0, 2.5])
"""Where the search for an equation begins: time constants in periods of the band, and damping ratios."""
LONGEST, FASTEST = 3.0, 1.5
"""Longest time constant, in records; fastest pole, over a step of the fit."""
AT_BOUND = 1.05
"""Lag, in the shortest one of a search, below which it is at its bound."""
MOST = 20_000
"""Samples at the beginning of a record by which the equation is found."""
DELAYS = np.unique(np.round(np.geomspace(1.0, 1000.0, 40)).astype(int)).tolist()
"""Dead times that are tried, in samples."""
MOST_STEPS, FEW = 3000, 30
"""Steps by which dead times are found, and how often the longest one that is tried fits into a record."""
GAIN = 0.95
"""Error that a dead time must leave, in that without it: a lag of higher order looks like a short one."""


def late(values: Array, samples: int) -> Array:
    """A signal so many samples later; its first value stood before."""
    return np.concatenate([np.full(samples, values[0]), values[: len(values) - samples]])


def delays_of(outputs: Sequence[Array], inputs: Sequence[Array], every: int, step: float, band: float) -> list[int]:
    """Samples by which each input acts later, one input after the other: those with which the changes of the nearest
    equations are nearest to the record's; 0 where these are hardly nearer.

    every: samples in a step [s]. band: frequency below which the outputs vary [Hz].
    """
    us = [values[: MOST_STEPS * every] for values in inputs]
    ys = [values[: MOST_STEPS * every] for values in outputs]
    searches = [_Search(y, us, every, step, band, by_changes=True) for y in ys]
    for search in searches:
        search.begin()
    found = [0] * len(us)

    def error(chosen: Sequence[int]) -> float:
        shifted = [late(values, delay) for values, delay in zip(us, chosen, strict=True)]
        return float(np.sqrt(sum(search.driven_by(shifted).least(1e-4) for search in searches)))

    for k in range(len(us)):
        tried = [delay for delay in DELAYS if delay * FEW < len(us[k])]
        errors = {delay: error([*found[:k], delay, *found[k + 1 :]]) for delay in (0, *tried)}
        best = min(errors, key=lambda delay: errors[delay])
        found[k] = best if errors[best] < GAIN * errors[0] else 0
    return found


def equation_of(output: Array, inputs: Sequence[Array], every: int, step: float, band: float) -> tuple[float, ...]:
    """First values (gains, offset, time constant [s], damping ratio) of T^2 y'' = g u + c - y - 2 d T y': those whose
    simulation is nearest to the record. T and d are searched; gains, offset and initial state follow by least squares
    (variable projection).
    """
    search = _Search(output[: MOST * every], [u[: MOST * every] for u in inputs], every, step, band)
    search.begin()
    search.least()
    _, found, constant, damping = search.solved(search.point)
    return (*found[: len(inputs) + 1].tolist(), constant, damping)


def is_first_order(constant: float, damping: float, step: float) -> bool:
    """Whether the faster one of two lags is at its bound, so that steps of fits do not tell it from none."""
    return damping > 1.0 and constant / (damping + np.sqrt(damping**2 - 1.0)) < AT_BOUND * step / FASTEST


class _Search:
    """The search for T and d of one output, in steps."""

    def __init__(
        self, output: Array, inputs: Sequence[Array], every: int, step: float, band: float, by_changes: bool = False
    ) -> None:
        """by_changes: errors are those of changes from step to step, which a slow error hardly moves."""
        self.every, self.step, self.band, self.by_changes = every, step, band, by_changes
        self.driven_by(inputs)
        self.y = output[::every][: len(self.us[0])]
        self.ends = np.log(
            [[CONSTANTS[0] / band, DAMPINGS[0] / 10.0], [LONGEST * step * len(self.y), 10.0 * DAMPINGS[-1]]]
        )

    def driven_by(self, inputs: Sequence[Array]) -> _Search:
        """Take these inputs (samples,) as held means over each step."""
        every = self.every
        self.us = [values[: len(values) // every * every].reshape(-1, every).mean(axis=1) for values in inputs]
        return self

    def solved(self, point: Array) -> tuple[Array, Array, float, float]:
        """Errors in the output's size (steps,), numbers that follow, T and d, of log T and log d."""
        damping = float(np.exp(point[1]))
        fastest = damping + np.sqrt(damping**2 - 1.0) if damping > 1.0 else 1.0
        constant = max(float(np.exp(point[0])), fastest * self.step / FASTEST)
        rows, aim = responses_of(self.us, self.step / constant, damping), self.y
        if self.by_changes:
            rows, aim = np.diff(rows, axis=0), np.diff(aim)
        found = np.asarray(np.linalg.lstsq(rows, aim, rcond=None)[0], dtype=np.float64)
        size = float(np.linalg.norm(aim - aim.mean())) or 1.0
        return np.asarray((rows @ found - aim) / size), found, float(constant), damping

    def begin(self) -> None:
        """Go to the best one of the beginnings."""
        beginnings = [np.log([t / self.band, d]) for t in CONSTANTS for d in DAMPINGS]
        first = min(beginnings, key=lambda point: float(np.sum(self.solved(point)[0] ** 2)))
        self.point = np.clip(first, self.ends[0] + 1e-9, self.ends[1] - 1e-9)

    def least(self, tolerance: float = 1e-8) -> float:
        """The least sum of squares from where the last search ended, but for a relative tolerance."""
        best = least_squares(lambda point: self.solved(point)[0], self.point, bounds=self.ends, ftol=tolerance)
        self.point = np.clip(best.x, self.ends[0] + 1e-9, self.ends[1] - 1e-9)
        return 2.0 * float(best.cost)


def responses_of(inputs: Sequence[Array], step: float, damping: float) -> Array:
    """Of y'' = u - y - 2 d y', to each input alone, to an offset and to both initial states, (samples, inputs + 3); the
    inputs are held.
    """
    law = np.array([[0.0, 1.0], [-1.0, -2.0 * damping]]), np.array([[0.0], [1.0]])
    kept, given, *_ = cont2discrete((*law, np.eye(2), np.zeros((2, 1))), step)
    a, b, c, d, e, f = (float(value) for value in (*kept.ravel(), *given.ravel()))
    poles, impulse = [1.0, -a - d, a * d - b * c], np.zeros(len(inputs[0]))
    impulse[0] = 1.0
    driven = [lfilter([0.0, e, b * f - d * e], poles, u) for u in inputs]
    free = [lfilter(numerator, poles, impulse) for numerator in ([1.0, -d], [0.0, b])]
    return np.column_stack([*driven, np.ones(len(impulse)), *free])
