"""How many more live shots until an interval is short enough."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy import stats

from hybrid_sysid_ros.extensions.accuracy.statistics.normal_inverse_wishart import NormalInverseWishart
from hybrid_sysid_ros.support.errors import UserError

MOST = 1_000_000
ASSURANCE = 0.9
Width = Callable[[NormalInverseWishart, int, int, float, float], float]


def mean_width(posterior: NormalInverseWishart, coordinate: int, more: int, level: float, assurance: float) -> float:
    """Width of a coordinate's mean interval after so many more shots, with a probability of ``assurance`` at most.

    2 t(f + m) sqrt(Psi_m / ((k + m) (f + m))), f the marginal degrees of freedom, Psi_m from :func:`_scale`
    """
    strength, free = posterior.strength + more, posterior.marginal_degrees + more
    scale = _scale(posterior, coordinate, more, assurance)
    return 2.0 * float(stats.t.ppf(0.5 + 0.5 * level, free)) * math.sqrt(scale / (strength * free))


def spread_width(posterior: NormalInverseWishart, coordinate: int, more: int, level: float, assurance: float) -> float:
    """Width of a coordinate's interval of its standard deviation, likewise."""
    free = posterior.marginal_degrees + more
    low, high = stats.chi2.ppf([0.5 - 0.5 * level, 0.5 + 0.5 * level], free)
    return math.sqrt(_scale(posterior, coordinate, more, assurance)) * float(1.0 / np.sqrt(low) - 1.0 / np.sqrt(high))


def shots_until(
    width: Width, posterior: NormalInverseWishart, coordinate: int, wanted: float, level: float,
    assurance: float = ASSURANCE,
) -> int:  # fmt: skip
    """How many more shots until ``width`` is at most ``wanted``; 0 where it is.

    Raises UserError where that takes more than MOST.
    """

    def short(more: int) -> bool:
        return width(posterior, coordinate, more, level, assurance) <= wanted

    if short(0):
        return 0
    low, high = 0, 1
    while not short(high):
        low, high = high, 2 * high
        if low > MOST:
            raise UserError(f"an interval as short as {wanted:g} takes more than {MOST} further shots: ask for a wider")
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if short(middle) else (middle, high)
    return high


def _scale(posterior: NormalInverseWishart, coordinate: int, more: int, assurance: float) -> float:
    """Quantile of a coordinate's scale after so many more shots, as it is predicted: given the variance, what m shots
    add to the scale is the variance times chi2(m), so Psi_m = Psi (1 + m F(m, f) / f).
    """
    scale, free = float(posterior.scale[coordinate, coordinate]), posterior.marginal_degrees
    return scale * (1.0 + more * float(stats.f.ppf(assurance, more, free)) / free) if more else scale
