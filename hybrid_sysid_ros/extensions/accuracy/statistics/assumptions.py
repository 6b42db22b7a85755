"""Whether shots are what the intervals take them for: of one kind, independent and normal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hybrid_sysid_ros.extensions.accuracy.statistics.shots import Shots
from hybrid_sysid_ros.support.arrays import Array

LEVEL = 0.01
"""p-value below which an assumption is doubted."""
OUTLIERS = 10
"""At most; more are rather another distribution."""
OUTLYING = 4
"""At most one shot in so many."""
ORDERED, PERMUTATIONS = 1000, 2000
"""Shots whose order is looked at, and orders that it is compared with."""
LONGEST = 5000
"""Shots up to which the test of Shapiro and Wilk is known."""
NOTICEABLE = 0.4
"""Skewness, or excess kurtosis, below which a departure from the normal distribution does no harm."""


@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """What was found of some shots."""

    shots: Shots
    outliers: tuple[int, ...]
    """Indices."""
    sentences: tuple[str, ...]
    """A sentence for each assumption that is doubted, without its end."""


def assumptions(shots: Shots, generator: np.random.Generator) -> Assumptions:
    """Look at shots (n, d) in the order in which they were fired."""
    outliers = outlying(shots.values)
    sentences = [*_outliers(shots, outliers), *_dependence(shots, generator), *_normality(shots, outliers)]
    return Assumptions(shots=shots, outliers=tuple(outliers), sentences=tuple(sentences))


def outlying(values: Array) -> list[int]:
    """Indices of outliers: Wilks's test of the outermost shot, again and again without it (Caroni and Prescott 1992,
    Applied Statistics 41; for one coordinate Rosner's of 1983). The outliers are all up to the last that is one, so
    that several do not hide each other.

    Of n shots with the scatter matrix S, u = n / (n - 1) (x - m)' S^-1 (x - m):  u / (1 - u) (n - d - 1) / d ~ F.
    """
    left, order, last = np.arange(len(values)), [], 0
    d = values.shape[1]
    for number in range(1, min(OUTLIERS, len(values) // OUTLYING) + 1):
        n = len(left)
        if n < d + 3:
            break
        part = values[left]
        offset = part - part.mean(axis=0)
        scatter = offset.T @ offset
        ratio = n / (n - 1) * np.einsum("ni,ni->n", offset, np.linalg.solve(scatter, offset.T).T)
        worst = int(np.argmax(ratio))
        odds = ratio[worst] / max(1.0 - ratio[worst], 1e-300)
        order.append(int(left[worst]))
        if n * stats.f.sf(odds * (n - d - 1) / d, d, n - d - 1) < LEVEL:
            last = number
        left = np.delete(left, worst)
    return sorted(order[:last])


def _outliers(shots: Shots, outliers: Sequence[int]) -> Iterator[str]:
    if not outliers:
        return
    others = np.delete(shots.values, outliers, axis=0)
    far = (shots.values[outliers] - others.mean(axis=0)) / others.std(axis=0, ddof=1)
    k, worst = divmod(int(np.argmax(np.abs(far))), far.shape[1])
    which = f"shot {outliers[0] + 1} is an outlier"
    if len(outliers) > 1:
        which = f"shots {', '.join(str(shot + 1) for shot in outliers)} are outliers"
    yield (
        f"{shots.name}: {which} ({shots.names[worst]} of shot {outliers[k] + 1} is {far[k, worst]:+.3g} standard "
        "deviations from the others): look for the cause, and leave a shot out only with its cause stated"
    )


def _dependence(shots: Shots, generator: np.random.Generator) -> Iterator[str]:
    """By the correlation of each shot with the next, against those of shuffled shots."""
    ranked = stats.rankdata(shots.values[:ORDERED], axis=0)  # so that no outlier decides
    centred = ranked - ranked.mean(axis=0)
    found = _correlation(centred)
    worst = int(np.argmax(np.abs(found)))
    probability = stats.permutation_test(
        (np.arange(len(centred)),), lambda order: np.abs(_correlation(centred[order])).max(),
        permutation_type="pairings", alternative="greater", n_resamples=PERMUTATIONS, random_state=generator,
    ).pvalue  # fmt: skip
    if probability < LEVEL:
        yield (
            f"{shots.name}: shots depend on those before them ({shots.names[worst]} by a rank correlation of "
            f"{found[worst]:.2g}, p {probability:.2g}): the intervals do not hold; take one number of each run, and "
            "look for a drift"
        )


def _correlation(centred: Array) -> Array:
    """Of each coordinate with its next value, (d,)."""
    return np.asarray(np.sum(centred[1:] * centred[:-1], axis=0) / np.sum(centred**2, axis=0))


def _normality(shots: Shots, outliers: Sequence[int]) -> Iterator[str]:
    values = np.delete(shots.values, outliers, axis=0)
    for name, column in zip(shots.names, values.T, strict=True):
        probability = float(stats.shapiro(column[:LONGEST]).pvalue)
        skewness, excess = float(stats.skew(column)), float(stats.kurtosis(column))
        if probability * len(shots.names) < LEVEL and max(abs(skewness), abs(excess)) > NOTICEABLE:
            factor = np.sqrt(max(1.0 + 0.5 * excess, 0.0))
            effect = f"the interval of its standard deviation needs some {factor:.2g} times the width"
            yield (
                f"{shots.name}: {name} is not normal (Shapiro-Wilk p {probability:.2g}): "
                f"{effect if factor > 1.0 else 'the interval of its mean may be off to one side'}; transform it, "
                "such as by its logarithm, or look for two kinds of shots"
            )
