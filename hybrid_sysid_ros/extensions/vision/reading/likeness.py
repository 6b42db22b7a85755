"""Likeness of two pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

WINDOW, TRUNCATE = 1.5, 3.5  # pixels, deviation of the Gaussian window, and deviations at which it ends: 11 by 11
STEADY = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
"""Which keep the quotient steady where pictures are dark or plain."""


def structural_similarity(one: NDArray[np.generic], other: NDArray[np.generic], where: NDArray[np.bool_]) -> float:
    """Structural similarity of two pictures [counts], at most 1: its mean over the pixels ``where`` (rows, columns).

        (2 m1 m2 + c1) (2 s12 + c2) / ((m1^2 + m2^2 + c1) (s1^2 + s2^2 + c2))

    With means, variances and covariance in a Gaussian window (Wang, Bovik, Sheikh, Simoncelli 2004).
    """
    first, second = one.astype(np.float64), other.astype(np.float64)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(gaussian_filter(values, WINDOW, truncate=TRUNCATE))

    m1, m2, (c1, c2) = mean(first), mean(second), STEADY
    s11, s22, s12 = mean(first**2) - m1**2, mean(second**2) - m2**2, mean(first * second) - m1 * m2
    found = (2.0 * m1 * m2 + c1) * (2.0 * s12 + c2) / ((m1**2 + m2**2 + c1) * (s11 + s22 + c2))
    return float(found[where].mean())
