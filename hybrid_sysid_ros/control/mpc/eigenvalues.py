"""Eigenvalues of small symmetric matrices: what these lack to be positive semidefinite.

Jacobi's rotations: Golub & Van Loan (2013), Matrix computations, section 8.5. NumPy's can't be printed as C.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

SWEEPS, PRECISION = 10, 1e-7
"""Most sweeps of rotations, and the size of what is beside the diagonal, relative to it, that ends them."""


@inner
def find_lack(matrix: Array) -> None:
    """Replace a symmetric matrix (n, n) by the least one that makes it positive semidefinite: the sum of -l v v' over
    its negative eigenvalues l, with their vectors v.
    """
    n = matrix.shape[0]
    vectors, values = np.zeros((n, n)), np.empty(n)
    for p in range(n):
        vectors[p, p] = 1.0
    for _ in range(SWEEPS):
        if _is_diagonal(matrix):
            break
        for p in range(n):
            for q in range(p + 1, n):
                if matrix[p, q] != 0.0:
                    _rotate(matrix, vectors, p, q)
    for p in range(n):
        values[p] = matrix[p, p]
        for q in range(n):
            matrix[p, q] = 0.0
    for k in range(n):
        for p in range(n if values[k] < 0.0 else 0):
            for q in range(n):
                matrix[p, q] -= values[k] * vectors[k, p] * vectors[k, q]


@inner
def _is_diagonal(matrix: Array) -> bool:
    beside = along = 0.0
    for p in range(matrix.shape[0]):
        along += matrix[p, p] * matrix[p, p]
        for q in range(p):
            beside += matrix[p, q] * matrix[p, q]
    return beside <= PRECISION * PRECISION * along


@inner
def _rotate(matrix: Array, vectors: Array, p: int, q: int) -> None:
    """Rotate rows and columns p and q so that their entry beside the diagonal is zero, and the rows of ``vectors``."""
    ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
    cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(matrix.shape[0]):
        _turn(matrix, p, k, q, k, cosine, sine)
        _turn(vectors, p, k, q, k, cosine, sine)
    for k in range(matrix.shape[0]):
        _turn(matrix, k, p, k, q, cosine, sine)


@inner
def _turn(matrix: Array, p: int, c: int, q: int, d: int, cosine: float, sine: float) -> None:
    """Turn the entries (p, c) and (q, d) as the parts of a plane vector."""
    one, other = matrix[p, c], matrix[q, d]
    matrix[p, c], matrix[q, d] = cosine * one - sine * other, sine * one + cosine * other
