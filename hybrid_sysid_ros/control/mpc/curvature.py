"""The Hessian of the Lagrangian where Gauss-Newton's is not enough: curvature of the dynamics, kept positive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner

Array = NDArray[np.float64]

LEAST_SHIFT = 1e-4
"""Added to the diagonal of a Hessian that is not positive, in shares of Gauss-Newton's largest entry; doubled until it
is. More than it takes makes steps short, and much less long ones.
"""


@inner
def add_curvature(horizon: Horizon, program: Program) -> None:
    """Add E' curvature_i E of all intervals to the Hessian, E (n + m, v) being the derivative of an interval's state
    and inputs by all inputs, and make it positive definite.
    """
    (count, n), m, v = horizon.reached.shape, horizon.inputs.shape[1], program.gradient.shape[0]
    largest = 0.0
    for c in range(v):
        largest = max(largest, program.hessian[c, c])
    moved, bent = np.zeros((n + m, v)), np.zeros((n + m, v))
    hessian, e, t, driven = pointer(program.hessian), pointer(moved), pointer(bent), pointer(horizon.driven)
    for i in range(count):
        wide = (i + 1) * m
        for a in range(n):
            for c in range(i * m):
                e[a * v + c] = driven[((i - 1) * n + a) * v + c]
            for c in range(i * m, wide):
                e[a * v + c] = 0.0
        for j in range(m):
            for c in range(wide):
                e[(n + j) * v + c] = 1.0 if c == i * m + j else 0.0
        for a in range(n + m):
            for c in range(wide):
                t[a * v + c] = 0.0
            for b in range(n + m):
                slope = horizon.curvature[i, a, b]
                for c in range(wide):
                    t[a * v + c] += slope * e[b * v + c]
        for a in range(n + m):
            for c in range(wide):
                slope, to = e[a * v + c], c * v
                if slope != 0.0:
                    for d in range(wide):
                        hessian[to + d] += slope * t[a * v + d]
    _make_positive(program.hessian, LEAST_SHIFT * largest)


@inner
def _make_positive(hessian: Array, shift: float) -> None:
    """Shift the diagonal until the Hessian is positive definite; one that is no number stays as it is."""
    factor = np.empty_like(hessian)
    for _ in range(60):
        if _factorise(hessian, factor):
            return
        for c in range(hessian.shape[0]):
            hessian[c, c] += shift
        shift *= 2.0


@inner
def _factorise(hessian: Array, factor: Array) -> bool:
    """Cholesky's factor; False where a matrix is not positive definite."""
    v = hessian.shape[0]
    h, f = pointer(hessian), pointer(factor)
    for c in range(v):
        for d in range(c + 1):
            total = h[c * v + d]
            for k in range(d):
                total -= f[c * v + k] * f[d * v + k]
            if c == d:
                if not total > 0.0:
                    return False
                f[c * v + c] = math.sqrt(total)
            else:
                f[c * v + d] = total / f[d * v + d]
    return True
