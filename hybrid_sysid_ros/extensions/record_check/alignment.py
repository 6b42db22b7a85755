"""Alignment: lag, sign and scale at which two signals agree best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate

from hybrid_sysid_ros.support.arrays import Array

RELATED, CLEAR, BEYOND = 0.45, 0.6, 3.0
"""Correlations below which nothing is related, and above which delay and scale mean something; ratio of motions above
which the scale is wrong whatever the correlation."""
SHORTEST_LAG, SHARE = 2.4, 0.12
"""Delay from which it is a fault, in samples and in times of a change: the longer one."""

LONGER, ABOVE_CHANCE = 4, 2.0
"""Times of a change over which white noise hides less, and correlation in that by chance, from which it is none."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Best agreement of two signals."""

    correlation: float
    lag: float
    """By which the measured one is late, in samples."""
    scale: float
    """Measured over expected."""


def changes(values: Array, apart: int) -> Array:
    """Differences between samples so far apart."""
    return np.asarray(values[apart:] - values[:-apart])


def time_of_change(values: Array) -> int:
    """Samples in which a signal changes: a tenth of a period at the middle frequency of its rate's power."""
    power = np.abs(np.fft.rfft(np.diff(values) * np.hanning(len(values) - 1))) ** 2
    share = np.cumsum(power) / max(power.sum(), 1e-300)
    middle = max(int(np.argmax(share > 0.5)), 1)
    return int(np.clip(len(values) / middle / 10.0, 1, max(len(values) // 50, 1)))


def best_alignment(measured: Array, expected: Array, good: NDArray[np.bool_], apart: int, longest: int) -> Alignment:
    """The lag, sign and scale at which changes of two signals agree best."""
    m, p = (changes(uniform_filter1d(values, apart), apart) for values in (measured, expected))
    kept = good[apart:] & good[:-apart]
    m = np.where(kept, m - m[kept].mean() if kept.any() else 0.0, 0.0)
    p = p - p.mean()
    longest = min(longest, len(m) - 1)
    cross = correlate(m, p, method="fft")[len(m) - 1 - longest : len(m) + longest]
    power = float(np.sqrt((m @ m) * (p[kept] @ p[kept]))) or 1e-300
    correlation = cross / power
    best = int(np.argmax(np.abs(correlation)))
    if 0 < best < len(correlation) - 1:
        left, middle, right = np.abs(correlation[best - 1 : best + 2])
        bend = left - 2.0 * middle + right
        lag = best - longest + (0.5 * (left - right) / bend if bend < 0 else 0.0)
    else:
        lag = float(best - longest)
    return Alignment(
        correlation=float(correlation[best]), lag=float(lag), scale=float(cross[best] / max(p[kept] @ p[kept], 1e-300))
    )


def beyond_chance(measured: Array, expected: Array, good: NDArray[np.bool_], apart: int, longest: int) -> bool:
    """Whether a signal (samples,) in strong noise follows what is expected: clearly over a longer time, or better than
    the same run backwards, as which any signal is that has nothing to do with it.
    """
    long, near, back = (
        abs(best_alignment(measured, other, good, span, longest).correlation)
        for other, span in ((expected, LONGER * apart), (expected, apart), (expected[::-1], apart))
    )
    return long > CLEAR or near > ABOVE_CHANCE * back
