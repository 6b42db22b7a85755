"""Square roots of covariances, P = S S', compiled. Something may have no variance: its row of S is zero."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner

Array = NDArray[np.float64]

NO_VARIANCE = 1e-7
"""Share of a deviation that counts as none, where the rest is explained by earlier entries."""


@inner
def triangle(rows: Array, count: int, root: Array) -> None:
    """Lower triangular S (size, size) with S S' = A' A of the first ``count`` rows A (rows, size), which are destroyed.

    Householder's reflections: Golub, Van Loan (2013), Matrix Computations, algorithm 5.2.1. What has no variance beyond
    that of earlier entries has a column of zeros.
    """
    size, row = root.shape[0], 0
    for j in range(size):
        norm, earlier = 0.0, 0.0
        for i in range(row, count):
            norm += rows[i, j] * rows[i, j]
        for i in range(j):
            earlier += root[j, i] * root[j, i]
            root[i, j] = 0.0
        if norm <= NO_VARIANCE * NO_VARIANCE * earlier:
            for k in range(j, size):
                root[k, j] = 0.0
            continue
        norm = math.sqrt(norm)
        if rows[row, j] > 0.0:
            norm = -norm
        rows[row, j] -= norm
        scale = -1.0 / (norm * rows[row, j])
        root[j, j] = norm
        for k in range(j + 1, size):
            total = 0.0
            for i in range(row, count):
                total += rows[i, j] * rows[i, k]
            total *= scale
            for i in range(row, count):
                rows[i, k] -= total * rows[i, j]
            root[k, j] = rows[row, k]
        row += 1


@inner
def solve(root: Array, x: Array) -> None:
    """S^-1 x in place, S lower triangular; what has no variance has no say."""
    for i in range(x.shape[0]):
        for k in range(i):
            x[i] -= root[i, k] * x[k]
        x[i] = x[i] / root[i, i] if root[i, i] != 0.0 else 0.0


@inner
def solve_transposed(root: Array, x: Array) -> None:
    """S'^-1 x in place, S lower triangular; what has no variance has no say."""
    for i in range(x.shape[0] - 1, -1, -1):
        for k in range(i + 1, x.shape[0]):
            x[i] -= root[k, i] * x[k]
        x[i] = x[i] / root[i, i] if root[i, i] != 0.0 else 0.0


@inner
def squared(root: Array, out: Array) -> None:
    """P = S S'."""
    size = root.shape[0]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(size):
                total += root[i, k] * root[j, k]
            out[i, j] = out[j, i] = total
