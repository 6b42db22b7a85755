"""Cumulative sums of what a process shows, which cross a threshold soon after its mean has moved (Page 1954).

The mean and deviation of the undisturbed process are not known: each value is held against those before it,

    T_n = sqrt((n - 1) / n) (x_n - mean_{n-1}) / s_{n-1},   Z_n = Phi^-1(F_{n-2}(T_n)),

F: Student's distribution of n - 2 degrees of freedom. The Z_n of independent normal values are independent and standard
normal, from the third on: Hawkins (1987), The Statistician 36, 299-316.
"""

from __future__ import annotations

import math

from scipy.optimize import brentq
from scipy.special import ndtri, stdtr

SLACK = 0.5
"""Half of the shift that is to be found soonest, in deviations of a value."""
OVERSHOOT = 1.166
"""Of a normal walk over a threshold in discrete time, twice .583: Siegmund (1985), Sequential Analysis, chapter 10."""
LARGEST = 3.0
"""Most that one value counts: four seconds far off are a fault that other rules tell, no drift. One normal value in 740
is larger."""


def run_length(threshold: float) -> float:
    """Mean number of values until an undisturbed one-sided sum crosses a threshold, by Siegmund's approximation."""
    b = 2.0 * SLACK * (threshold + OVERSHOOT)
    return (math.exp(b) - b - 1.0) / (2.0 * SLACK**2)


def threshold_of(length: float) -> float:
    """The threshold that an undisturbed sum crosses after so many values on average."""
    return float(brentq(lambda threshold: run_length(threshold) - length, 0.0, 100.0))


class SelfStartingSum:
    """Sums of the deviations of values from those before them, upwards and, if asked for, downwards."""

    def __init__(self, threshold: float, *, both: bool) -> None:
        self.threshold, self._both = threshold, both
        self._count, self._mean, self._squares = 0, 0.0, 0.0
        self.up = self.down = 0.0

    def add(self, value: float) -> None:
        """Take a value."""
        n, away = self._count + 1, value - self._mean
        if n > 2 and self._squares > 0.0:
            deviation = math.sqrt(self._squares / (n - 2))
            normal = float(ndtri(stdtr(n - 2, math.sqrt((n - 1) / n) * away / deviation)))
            normal = min(max(normal, -LARGEST), LARGEST)
            self.up = max(0.0, self.up + normal - SLACK)
            self.down = max(0.0, self.down - normal - SLACK) if self._both else 0.0
        self._count, self._mean = n, self._mean + away / n
        self._squares += away * away * (n - 1) / n

    @property
    def crossed(self) -> bool:
        """Whether a sum is above the threshold."""
        return max(self.up, self.down) > self.threshold
