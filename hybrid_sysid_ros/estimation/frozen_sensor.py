"""Frozen sensors: they stay at a number, or dither about it by less than their noise does.

The mean square of the differences of some readings is 2 s^2 for white noise of deviation s, whatever moves slowly
beneath it; a frozen sensor is below STILL times that. The kernels are Python, and are printed as C.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.support.arrays import Floats

STILL = 0.05
"""Share of the variance that differences of white noise have, below which a sensor is frozen."""
ENOUGH = 20
"""Readings that this takes at least. Of white noise, one in 17 million runs of 20 is as still, but one in 260 of 5."""


@dataclass(slots=True)
class FrozenSensorDetector:
    """least: sum of squares below which a sensor is frozen, 0: never. last: its last reading. at, filled: place of the
    next square in the ring, and how many are in it. count: readings that were found frozen.
    """

    least: float
    last: float = math.nan
    at: int = 0
    filled: int = 0
    count: int = 0


def frozen_detectors(noise: Sequence[float], after: int) -> tuple[list[FrozenSensorDetector], list[float]]:
    """Detectors of sensors (p,), and the ring of squares (p after,) of each. noise (p,): deviations, 0 where a sensor
    has none that would tell. after: readings, or ENOUGH where these are more; 0: never.
    """
    after = max(after, ENOUGH) if after else 0
    return [FrozenSensorDetector(STILL * 2.0 * item**2 * after) for item in noise], [0.0] * (len(noise) * after)


def is_frozen(detector: FrozenSensorDetector, ring: Floats, k: int, after: int, reading: float) -> bool:
    """Whether this reading of sensor k and those before it have been too still for too long."""
    change, detector.last = reading - detector.last, reading
    if after == 0:
        return False
    if not change * change < math.inf:
        detector.filled = 0
        return False
    ring[k * after + detector.at] = change * change
    detector.at, detector.filled = (detector.at + 1) % after, min(detector.filled + 1, after)
    if detector.filled < after or not detector.least > 0.0:
        return False
    total = 0.0
    for i in range(after):
        total += ring[k * after + (detector.at + i) % after]
    if total > detector.least:
        return False
    detector.count += 1
    return True
