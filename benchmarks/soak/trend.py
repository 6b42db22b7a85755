"""Trend: whether a quantity grows over a run, and how often something came too late."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

SETTLING = 0.1
"""Share of a run, at its begin, that no trend looks at: first uses touch memory."""


def trend(times: ArrayLike, values: ArrayLike, *, allowed: float) -> dict[str, Any]:
    """Straight line through values over times [s], both (samples,), without the first SETTLING of the time and NaN.

    slope and its standard error are by the hour, from the residuals about the line as if they were independent. What a
    run rose by is the median of the last third less that of the first. It grows where that is more than ``allowed`` (in
    the values' unit) and the line rises by more than two standard errors. None where there are too few to say.
    """
    t, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    kept = (t >= t[0] + SETTLING * (t[-1] - t[0])) & np.isfinite(y)
    t, y = t[kept] / 3600.0, y[kept]
    if len(t) < 4:
        return {"slope_per_hour": None, "error_per_hour": None, "rose": None, "grows": False}
    centred, offset = t - t.mean(), y - y.mean()
    slope = float(centred @ offset / (centred @ centred))
    residuals = offset - slope * centred
    error = float(np.sqrt(residuals @ residuals / (len(t) - 2) / (centred @ centred)))
    third = max(len(t) // 3, 1)
    rose = float(np.median(y[-third:]) - np.median(y[:third]))
    return {
        "slope_per_hour": slope,
        "error_per_hour": error,
        "rose": rose,
        "grows": rose > allowed and slope > 2.0 * error,
    }


def too_late(late: ArrayLike, limit: float) -> int:
    """How many of the latenesses (deadlines,) [s] are beyond a limit [s]."""
    return int(np.count_nonzero(np.asarray(late) > limit))


def excess(ours: int, theirs: int) -> float:
    """Probability of at least ``ours`` events of ours + theirs, if both came at the same rate and independently: small
    where ours came more often (one-sided conditional test of two Poisson rates, Przyborowski and Wilenski 1940).
    """
    from scipy.stats import binom

    return float(binom.sf(ours - 1, ours + theirs, 0.5)) if ours + theirs else 1.0
