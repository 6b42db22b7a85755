"""Wrapping: an angle that a sensor gives modulo a turn."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.shared.units import named
from hybrid_sysid_ros.support.arrays import Array

NEAR, JUMP = 0.05, 0.8
"""By which the span of what wraps differs from a turn at most, in a turn, and least jump."""
BEFORE = 3
"""Samples before and after a jump that show which way the angle turns there."""
SHARE = 0.5
"""Of jumps that go against the motion around them."""


def turn_of(unit: str) -> float | None:
    """A turn in a unit, such as 360 of "deg"; None for units of no angle."""
    found = named(unit)
    return 2.0 * math.pi / found.factor if found is not None and (found.base, found.per) == ("rad", 0) else None


def wraps_of(values: Array, turn: float) -> NDArray[np.intp]:
    """Samples (wraps,) behind which an angle (samples,) wraps; none where it does not."""
    known = values[np.isfinite(values)]
    if len(known) < 2 * BEFORE + 3 or abs(float(np.ptp(known)) / turn - 1.0) > NEAR:
        return np.empty(0, dtype=np.intp)
    first, _ = _jumps(values, turn)
    inside = first[(first >= BEFORE) & (first + 2 + BEFORE < len(values))]
    jump = values[inside + 2] - values[inside]
    before = values[inside] - values[inside - BEFORE]
    after = values[inside + 2 + BEFORE] - values[inside + 2]
    against = (jump * before < 0.0) & (jump * after < 0.0)
    return first if len(inside) and against.mean() >= SHARE else np.empty(0, dtype=np.intp)


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
        single = np.abs(np.diff(values)) > JUMP * turn
        double = np.abs(values[2:] - values[:-2]) > JUMP * turn
    torn = double & ~single[:-1] & ~single[1:]
    torn[1:] &= ~torn[:-1]
    first = np.flatnonzero(single | np.append(torn, False))
    return first, ~single[first]
