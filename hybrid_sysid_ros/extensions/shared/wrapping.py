"""Wrapping: an angle that a sensor gives modulo a turn."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.rigs.units import named
from hybrid_sysid_ros.support.arrays import Array

NEAR, LEAST = 0.05, 0.8
"""By which the span of what wraps differs from a turn at most, in a turn, and least jump."""
AFTER = 3
"""Samples behind a jump that show whether what jumped goes on that way."""
LARGE, LARGEST = 0.9, 0.2
"""Quantile of the steps that are no jumps and not zero, and that quantile at most, in a turn: beyond nothing tells a
jump from a step.
"""
LIKE = 3.0
"""Ratio of what a jump lacks to a turn to that step, at most: it is the motion in the sample."""
SHARE, ONWARD = 0.8, 0.7
"""Least share of the jumps that are less than a turn by a step, and share from which jumps that go on are answers."""


def turn_of(unit: str) -> float | None:
    """A turn in a unit, such as 360 of "deg"; None for units of no angle."""
    found = named(unit)
    return 2.0 * math.pi / found.factor if found is not None and (found.base, found.per) == ("rad", 0) else None


def unit_of_wraps(values: Array) -> str:
    """The unit in which values (samples,) come modulo a turn, "rad" or "deg"; "" where they don't."""
    return next((unit for unit in ("rad", "deg") if len(wraps_of(values, turn_of(unit) or 1.0))), "")


def wraps_of(values: Array, turn: float) -> NDArray[np.intp]:
    """Samples (wraps,) behind which an angle (samples,) wraps; none where it does not."""
    none, known = np.empty(0, dtype=np.intp), values[np.isfinite(values)]
    if len(known) < AFTER + 3 or abs(float(np.ptp(known)) / turn - 1.0) > NEAR:
        return none
    first, torn = _jumps(values, turn)
    inside, last = first[first + 2 + AFTER < len(values)], first + 1 + torn
    steps = np.abs(np.diff(values))
    steps = steps[(steps > 0.0) & (steps < LEAST * turn)]
    large = float(np.quantile(steps, LARGE)) if len(steps) else np.inf
    if not len(inside) or large > LARGEST * turn:
        return none
    jump = values[last] - values[first]
    lacks = turn - np.abs(jump)
    onward = values[inside + 2 + AFTER] - values[inside + 2]
    like_a_step = (lacks > 0.0) & (lacks <= LIKE * large)
    goes_on = onward * jump[: len(inside)] > 0.0
    return first if like_a_step.mean() >= SHARE and goes_on.mean() < ONWARD else none


def unwrapped(values: Array, turn: float) -> Array:
    """The whole angle of one that wraps, both (samples,); a sample that a filter has between both ends is replaced."""
    first, torn = _jumps(values, turn)
    kept = np.isfinite(values)
    kept[first[torn] + 1] = False
    if not kept.any():
        return values
    at = np.flatnonzero(kept)
    whole = np.interp(np.arange(len(values)), at, np.unwrap(values[at], period=turn))
    return np.where(np.isfinite(values), whole, np.nan)


def _jumps(values: Array, turn: float) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Last samples before jumps, and which of these take two steps, so that the sample behind is torn."""
    with np.errstate(invalid="ignore"):
        single = np.abs(np.diff(values)) > LEAST * turn
        double = np.abs(values[2:] - values[:-2]) > LEAST * turn
    torn = double & ~single[:-1] & ~single[1:]
    torn[1:] &= ~torn[:-1]
    first = np.flatnonzero(single | np.append(torn, False))
    return first, ~single[first]
