"""Reference plans: what the outputs are to follow, and how few points straight lines need for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Ability:
    """The largest speed and acceleration of each output that the rig reaches, as it is shown (outputs,)."""

    speed: Array
    acceleration: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePlan:
    """References between points, straight lines between them, the last one held; outputs as they are shown."""

    times: Array
    """(points,) [s], from 0 on."""
    values: Array
    """(points, outputs), 0 for outputs that are not tracked."""
    jumps: bool = False
    """Whether it steps, which nothing follows at once."""
    stops: bool = False
    """Whether the inputs go to rest at its end."""
    story: tuple[str, ...] = ()
    """What was understood, part by part, in numbers."""

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def __call__(self, t: ArrayLike) -> Array:
        """References (..., outputs) at times of any shape [s]."""
        at = np.asarray(t, dtype=float)
        return np.stack([np.interp(at, self.times, column) for column in self.values.T], axis=-1)


def needed(times: Array, rows: Array, tolerances: Sequence[float]) -> list[int]:
    """Indices of the points (points,) that straight lines need to stay within tolerances (columns,) of all of them.

    From each kept point a door of slopes closes as points pass; the last one that the door lets in is kept (swinging
    door, Bristol 1990).
    """
    slack = np.where(np.isfinite(tolerances), tolerances, np.inf)
    kept = np.zeros(len(times), dtype=np.int64)
    count = _swinging_door(np.ascontiguousarray(times), np.ascontiguousarray(rows), slack, kept)
    return [*kept[:count].tolist(), len(times) - 1]


@kernel
def _swinging_door(times: Array, rows: Array, slack: Array, kept: NDArray[np.int64]) -> int:
    """Write the kept indices but the last into ``kept`` (points,), whose first is 0; how many they are."""
    low, high = np.full(rows.shape[1], -np.inf), np.full(rows.shape[1], np.inf)
    count, k = 1, 1
    while k < times.shape[0]:
        begin = kept[count - 1]
        passed = times[k] - times[begin]
        outside = False
        for j in range(rows.shape[1]):
            slope = (rows[k, j] - rows[begin, j]) / passed
            outside = outside or slope < low[j] or slope > high[j]
        if outside:
            kept[count] = k - 1
            count += 1
            low[:], high[:] = -np.inf, np.inf
            continue
        for j in range(rows.shape[1]):
            slope = (rows[k, j] - rows[begin, j]) / passed
            low[j] = max(low[j], slope - slack[j] / passed)
            high[j] = min(high[j], slope + slack[j] / passed)
        k += 1
    return count
