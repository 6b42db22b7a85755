"""Square roots of covariances, P = S S', compiled. Something may have no variance: its row of S is zero."""

from __future__ import annotations

import math

from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

NO_VARIANCE = 1e-7
"""Share of a deviation that counts as none, where the rest is explained by earlier entries."""


@inner
def triangle(rows: Array, count: int, root: Array) -> None:
    """Lower triangular S (size, size) with S S' = A' A of the first ``count`` rows A (rows, size), which are destroyed.

    Householder's reflections: Golub, Van Loan (2013), Matrix Computations, algorithm 5.2.1. What has no variance beyond
    that of earlier entries has a column of zeros.
    """
    size, row = root.shape[0], 0
    a, s = pointer(rows), pointer(root)  # bare memory, whose loops are fast
    for j in range(size):
        norm, earlier = 0.0, 0.0
        for i in range(row, count):
            norm += a[i * size + j] * a[i * size + j]
        for i in range(j):
            earlier += s[j * size + i] * s[j * size + i]
            s[i * size + j] = 0.0
        if norm <= NO_VARIANCE * NO_VARIANCE * earlier:
            for k in range(j, size):
                s[k * size + j] = 0.0
            continue
        norm = math.sqrt(norm)
        if a[row * size + j] > 0.0:
            norm = -norm
        a[row * size + j] -= norm
        scale = -1.0 / (norm * a[row * size + j])
        s[j * size + j] = norm
        for k in range(j + 1, size):
            total = 0.0
            for i in range(row, count):
                total += a[i * size + j] * a[i * size + k]
            total *= scale
            for i in range(row, count):
                a[i * size + k] -= total * a[i * size + j]
            s[k * size + j] = a[row * size + k]
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
