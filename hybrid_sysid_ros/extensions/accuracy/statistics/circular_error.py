"""Circular error probable: the radius about the mean point of impact that half of all shots meet."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.optimize import brentq
from scipy.special import erf

from hybrid_sysid_ros.support.arrays import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
DEGREE = 40


def circular_error_probable(covariance: Array) -> Array:
    """Radius (...) about the mean, of covariances (..., 2, 2), to 1e-6 of it.

    About the aim point it would need the mean too, and no interval of that holds its level: |mean|^2 is overestimated.
    """
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    half = np.sqrt(np.maximum(0.25 * trace**2 - np.linalg.det(covariance), 0.0))
    large, small = np.sqrt(0.5 * trace + half), np.sqrt(np.maximum(0.5 * trace - half, 0.0))
    found: Array = large * _factors()(small / large)
    return found


def probability_within(radius: float, large: float, small: float) -> float:
    """Of a circle about the mean, for standard deviations large >= small > 0 along the principal axes.

    integral over x of the density of x and P(|y| <= sqrt(radius^2 - x^2)), with x = radius sin t
    """
    angle = 0.5 * np.pi * NODES
    x, reach = radius * np.sin(angle), radius * np.cos(angle)
    density = np.exp(-0.5 * (x / large) ** 2) / (np.sqrt(2.0 * np.pi) * large)
    return float(0.5 * np.pi * WEIGHTS @ (density * erf(reach / (np.sqrt(2.0) * small)) * reach))


@cache
def _factors() -> Chebyshev:
    """The radius for a large standard deviation of 1 over the small one, 0 to 1."""

    def radius(small: float) -> float:
        return float(brentq(lambda r: probability_within(r, 1.0, max(small, 1e-9)) - 0.5, 0.6, 1.2, xtol=1e-13))

    return Chebyshev.interpolate(np.vectorize(radius), DEGREE, domain=[0.0, 1.0])
