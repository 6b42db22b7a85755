"""Square roots of covariances in which something may have no variance, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner

Array = NDArray[np.float64]


@inner
def factorise(matrix: Array) -> None:
    """Cholesky in place, P = L L'; rows and columns without any variance stay zero."""
    for j in range(matrix.shape[0]):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        root = math.sqrt(pivot) if pivot > 1e-14 * matrix[j, j] else 0.0
        matrix[j, j] = root
        for i in range(j + 1, matrix.shape[0]):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / root if root > 0.0 else 0.0


@inner
def solve_factorised(factor: Array, x: Array) -> None:
    """P x = b in place; what has no variance has no say."""
    size = x.shape[0]
    for i in range(size):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] = x[i] / factor[i, i] if factor[i, i] > 0.0 else 0.0
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            x[i] -= factor[k, i] * x[k]
        x[i] = x[i] / factor[i, i] if factor[i, i] > 0.0 else 0.0
