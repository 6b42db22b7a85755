"""Whether an estimator is as sure as it may be: normalised squares, and the bands that chance leaves them.

Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NORMAL = 1.959963984540054
"""Deviations about the mean that hold 95 % of a normal distribution."""


def normalised_errors(errors: Array, covariances: Array) -> Array:
    """Squares e' P^-1 e of errors (..., n) under covariances (..., n, n); of a consistent estimator n in the mean."""
    return np.asarray(np.einsum("...i,...i->...", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))


def band(samples: int, degrees: int = 1) -> tuple[float, float]:
    """The 95 % band of the mean of ``samples`` independent chi-square numbers of so many degrees of freedom.

    By the cube root that Wilson & Hilferty (1931) found nearly normal: within 1 % from 10 degrees, .1 % from 100.
    """
    total = samples * degrees
    spread = 2.0 / (9.0 * total)
    low, high = (total * (1.0 - spread + sign * NORMAL * math.sqrt(spread)) ** 3 / samples for sign in (-1.0, 1.0))
    return max(low, 0.0), high


class Window:
    """Mean of the last normalised innovations, and how many they are; NaN is no innovation."""

    def __init__(self, length: int) -> None:
        self._values: deque[float] = deque(maxlen=length)

    def add(self, value: float) -> None:
        if math.isfinite(value):
            self._values.append(value)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def mean(self) -> float:
        """NaN where there is none."""
        return math.fsum(self._values) / len(self._values) if self._values else math.nan
