"""Whether shots of a rig are those of its model: by many numbers of each shot, without a distribution assumed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from hybrid_sysid_ros.support.arrays import Array

PERMUTATIONS = 4000
LEVEL = 0.05
"""Probability with which a right model is contradicted by any of its numbers."""
ASSURED = 1.2816
"""Quantile of the normal distribution for a power of 90 %."""
TINY = 1e-9
"""Deviation below which numbers are the same, as a share of their size."""


class Verdict(Enum):
    """What live shots say of a model."""

    AGREES = "agrees"
    CONTRADICTED = "contradicted"
    OPEN = "too few shots to say"


@dataclass(frozen=True, kw_only=True)
class ShotQuantity:
    """A number of each shot, or several that belong together, such as a path at several times."""

    name: str
    unit: str
    values: Array
    """(shots, k)."""
    size: float | None = None
    """What a difference is a share of; the mean of the number itself by default."""


@dataclass(frozen=True, kw_only=True)
class ShotComparison:
    """A quantity of live shots against simulated ones. Of several numbers each is the root mean square."""

    name: str
    unit: str
    simulated: float
    live: float
    difference: float
    bound: float
    """The difference is at most so large, simultaneously for all quantities at LEVEL."""
    noticed: float
    """A difference that would have been noticed in 90 % of cases."""
    size: float
    probability: float
    """p-value, adjusted for all quantities."""
    matters: float
    """Share of the size up to which a difference does not matter."""

    @property
    def verdict(self) -> Verdict:
        """A difference that is no chance and may matter contradicts; one that is bounded below what matters agrees."""
        if self.bound <= self.matters * self.size:
            return Verdict.AGREES
        return Verdict.CONTRADICTED if self.probability < LEVEL else Verdict.OPEN


def compare(
    simulated: Sequence[ShotQuantity], live: Sequence[ShotQuantity], generator: np.random.Generator, *, matters: float
) -> list[ShotComparison]:
    """Compare the same quantities of two kinds of shots.

    Each number by Student's statistic with the pooled deviation. The largest of all, against those of shots whose kinds
    are exchanged at random, has a p-value that is exact for a model that is the rig, however numbers depend on each
    other (Westfall and Young 1993, Resampling-Based Multiple Testing, maxT).
    """
    one, two = (np.hstack([item.values for item in items]) for items in (simulated, live))
    owners = np.repeat(np.arange(len(live)), [item.values.shape[1] for item in live])
    together, count = np.vstack([one, two]), len(two)
    shift = together.mean(axis=0)
    together = together - shift
    least = TINY * np.maximum(np.abs(shift), np.abs(together).max(axis=0)) + np.finfo(float).tiny

    def differences(chosen: Array) -> tuple[Array, Array]:
        """Differences and their deviations (rows, numbers), live where chosen (rows, shots) is 1."""
        other = len(together) - count
        total, squares = together.sum(axis=0), np.sum(together**2, axis=0)
        mean = chosen @ together / count
        rest = (total - count * mean) / other
        variance = np.maximum(squares - count * mean**2 - other * rest**2, 0.0) / (len(together) - 2)
        deviation = np.sqrt(variance * (1.0 / count + 1.0 / other))
        return mean - rest, np.maximum(deviation, least)

    real = np.zeros((1, len(together)))
    real[0, len(one) :] = 1.0
    exchanged = np.zeros((PERMUTATIONS, len(together)))
    for row in exchanged:
        row[generator.permutation(len(together))[:count]] = 1.0
    largest = np.max(np.abs(np.divide(*differences(exchanged))), axis=1)
    critical = float(np.quantile(largest, 1.0 - LEVEL))
    difference, deviation = (part[0] for part in differences(real))
    found = []
    for k, (ours, theirs) in enumerate(zip(simulated, live, strict=True)):
        mine = owners == k
        worst = float(np.max(np.abs(difference[mine] / deviation[mine])))
        means = [_size(item.values.mean(axis=0)) for item in (ours, theirs)]
        off, wide = _size(difference[mine]), _size(deviation[mine])
        found.append(
            ShotComparison(
                name=theirs.name,
                unit=theirs.unit,
                simulated=means[0],
                live=means[1],
                difference=off,
                bound=off + critical * wide,
                noticed=(critical + ASSURED) * wide,
                size=means[0] if ours.size is None else ours.size,
                probability=float((1 + np.sum(largest >= worst)) / (1 + PERMUTATIONS)),
                matters=matters,
            )
        )
    return found


def needed(comparison: ShotComparison, live: int) -> int | None:
    """Live shots that would tell a difference that matters, by the deviations of so many; None where no number would
    (as simulated ones are too few).
    """
    ratio = comparison.noticed / max(comparison.matters * comparison.size, 1e-300)
    shots = live * ratio**2
    return math.ceil(shots) if math.isfinite(shots) and shots < 1e6 else None


def overall(comparisons: Sequence[ShotComparison]) -> Verdict:
    """Contradicted by any; open where any is."""
    verdicts = {item.verdict for item in comparisons}
    return next((word for word in (Verdict.CONTRADICTED, Verdict.OPEN) if word in verdicts), Verdict.AGREES)


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
