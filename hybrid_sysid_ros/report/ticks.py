"""Ticks: where an axis of a picture has its marks."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.support.arrays import Array


def ticks(low: float, high: float, about: int) -> Array:
    """Round numbers within low and high, some so many."""
    rough = (high - low) / about
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min(factor for factor in (1, 2, 5, 10) if factor * power >= rough * 0.999)
    counts: Array = np.arange(np.ceil(low / step), np.floor(high / step) + 1, dtype=np.float64)
    return step * counts + 0.0  # -0 is no tick
