"""The inputs of the last moments, for models with an input delay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class InputHistory:
    """Remembers mean inputs over intervals and tells their mean over any other interval.

    Kept as the integral of the input at the ends of the intervals, so that a mean is one difference.
    """

    def __init__(self, inputs: int, *, length: int = 64) -> None:
        self._times = np.zeros(length)
        self._integrals = np.zeros((length, inputs))
        self._first = np.zeros(inputs)

    def reset(self, time: float, value: Array) -> None:
        """The input has been ``value`` (inputs,) for ever, until ``time`` [s]."""
        length = len(self._times)
        self._times[:] = time - np.arange(length, 0, -1) + 1.0
        self._integrals[:] = (self._times - time)[:, None] * value
        self._last = np.array(value, dtype=float)

    def append(self, time: float, value: Array) -> None:
        """From the last time to this one the input was ``value`` (inputs,) in the mean."""
        span = time - self._times[-1]
        self._times[:-1] = self._times[1:]
        self._integrals[:-1] = self._integrals[1:]
        self._times[-1] = time
        self._integrals[-1] = self._integrals[-2] + span * value
        self._last[:] = value

    def mean(self, start: float, stop: float) -> Array:
        """Mean input (inputs,) over [start, stop]; after the last known time the last value is held."""
        return (self._integral(stop) - self._integral(start)) / (stop - start)

    def _integral(self, time: float) -> Array:
        times = self._times
        if time >= times[-1]:
            return self._integrals[-1] + (time - times[-1]) * self._last
        right = max(int(np.searchsorted(times, time, side="right")), 1)
        left = right - 1
        share = (time - times[left]) / (times[right] - times[left])
        return self._integrals[left] + share * (self._integrals[right] - self._integrals[left])
