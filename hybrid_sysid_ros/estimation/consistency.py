"""Consistency of an estimator: normalised squared errors, and the bands in which they lie by chance.

Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.support.arrays import Array

NORMAL = 1.959963984540054
"""Deviations around the mean that contain 95 % of a normal distribution."""


def normalised_errors(errors: Array, covariances: Array) -> Array:
    """Squares e' P^-1 e of errors (..., n) for covariances (..., n, n); their mean is n for a consistent estimator."""
    return np.asarray(np.einsum("...i,...i->...", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))


def band(samples: int, degrees: int = 1) -> tuple[float, float]:
    """The 95 % band of the mean of ``samples`` independent chi-square numbers with ``degrees`` of freedom.

    It uses the nearly normal cube root of Wilson & Hilferty (1931): within 1 % from 10 degrees, .1 % from 100.
    """
    total = samples * degrees
    spread = 2.0 / (9.0 * total)
    low, high = (total * (1.0 - spread + sign * NORMAL * math.sqrt(spread)) ** 3 / samples for sign in (-1.0, 1.0))
    return max(low, 0.0), high
