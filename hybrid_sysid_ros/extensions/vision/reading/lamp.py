"""The lamp in a film: when it went on, and how surely."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.scene import Lamp
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CLEAR = 8.0  # deviations of the dark lamp, by which a lit one is brighter at least
LEAST = 6.0  # counts, the same
PART = 0.04  # of the exposure: a part that is lit less, or more than 1 less this, tells no time


@dataclass(frozen=True, kw_only=True)
class Onset:
    """When a lamp went on [s of the film], with its standard deviation."""

    time: float
    deviation: float


def brightness(picture: NDArray[np.uint8], lamp: Lamp) -> float:
    """Mean of the lamp's disc in a picture [counts]."""
    rows, columns = picture.shape
    x, y, radius = lamp.at[0] * columns - 0.5, lamp.at[1] * columns - 0.5, max(0.7 * lamp.radius * columns, 1.0)
    across = slice(max(math.ceil(x - radius), 0), max(min(math.floor(x + radius) + 1, columns), 0))
    down = slice(max(math.ceil(y - radius), 0), max(min(math.floor(y + radius) + 1, rows), 0))
    disc = picture[down, across]
    return float(disc.mean()) if disc.size else math.nan


def onset(times: Array, seen: Array, *, exposure: float) -> Onset:
    """When a lamp went on whose brightness was ``seen`` (frames,) while its rows were exposed about ``times`` [s].

    A frame that is lit in part tells the moment; one between two exposures is known to lie there.

    Raises UserError where it never goes on, goes off again, or was lit before the first frame.
    """
    steps = np.diff(seen)
    if len(seen) < 4 or not np.isfinite(seen).all():
        raise UserError("the lamp is not in the picture, or the film has fewer than 4 frames")
    first = int(np.argmax(steps)) + 1  # the frame with the largest rise
    around = max(len(seen) // 20, 5)
    dark = seen[max(first - around - 1, 0) : first - 1] if first > 1 else seen[:first]
    lit = seen[first + 1 : first + 1 + around]
    level, bright = float(np.median(dark)), float(np.median(lit)) if len(lit) else float(seen[-1])
    spread = float(np.median(np.abs(dark - level))) / 0.6745 if len(dark) > 2 else 1.0
    height = bright - level
    passes = float(np.median(seen[first:])) < level + 0.5 * height  # somebody who walks by
    if passes or height < max(CLEAR * spread, LEAST):
        raise UserError("no lamp goes on in the film: it is lit from the beginning, or never, or hidden")
    if seen[first - 1] > level + 0.5 * height and first > 1:
        first -= 1
    if first > 1 and seen[first - 1] > level + max(PART * height, 4.0 * spread):
        first -= 1
    part = (float(seen[first]) - level) / height
    noise = spread / height
    if PART < part < 1.0 - max(PART, 4.0 * noise):
        return Onset(time=float(times[first]) + exposure * (0.5 - part), deviation=max(noise, 0.01) * exposure)
    begin, end = float(times[first - 1]) + exposure / 2, float(times[first]) - exposure / 2
    if part <= PART:
        begin, end = end, float(times[min(first + 1, len(times) - 1)]) - exposure / 2
    return Onset(time=(begin + end) / 2, deviation=(end - begin) / math.sqrt(12.0))
