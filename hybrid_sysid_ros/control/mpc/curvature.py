"""The Hessian of the Lagrangian where Gauss-Newton's is not enough: curvature of the dynamics, kept positive."""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

LEAST_SHIFT = 1e-4
"""Added to the diagonal of a Hessian that is not positive, in shares of Gauss-Newton's largest entry; doubled until it
is. More than it takes makes steps short, and much less long ones.
"""

HOLD = 100.0
"""Curvature across active constraints, in shares of the largest entry of a Hessian that is not positive: far from the
reference it is many times Gauss-Newton's.
"""


@inner
def keep_derivatives(horizon: Horizon) -> None:
    """Keep [A, B] and where they were taken, for :func:`update_curvature`."""
    n, m = horizon.linear.B.shape[1:]
    for i in range(horizon.inputs.shape[0]):
        jacobian, point = horizon.lagrangian.jacobian[i], horizon.lagrangian.point[i]
        for a in range(n):
            point[a] = horizon.states[i, a]
            for b in range(n):
                jacobian[a, b] = horizon.linear.A[i, a, b]
            for j in range(m):
                jacobian[a, n + j] = horizon.linear.B[i, a, j]
        for j in range(m):
            point[n + j] = horizon.inputs[i, j]


@inner
def update_curvature(horizon: Horizon) -> None:
    """Symmetric rank-one update of each interval's curvature by how its [A, B] changed over the last step.

    Conn, Gould & Toint (1991), Mathematical Programming 50; interval by interval, a few steps tell it all.
    """
    n, m = horizon.linear.B.shape[1:]
    moved, off = np.empty(n + m), np.empty(n + m)
    for i in range(horizon.inputs.shape[0]):
        kept = horizon.lagrangian
        curvature, jacobian, point = kept.curvature[i], kept.jacobian[i], kept.point[i]
        for a in range(n):
            moved[a] = horizon.states[i, a] - point[a]
        for j in range(m):
            moved[n + j] = horizon.inputs[i, j] - point[n + j]
        across = far = size = 0.0
        for c in range(n + m):
            total = 0.0
            for a in range(n):
                now = horizon.linear.A[i, a, c] if c < n else horizon.linear.B[i, a, c - n]
                total += horizon.lagrangian.adjoint[i + 1, a] * (now - jacobian[a, c])
            for d in range(n + m):
                total -= curvature[c, d] * moved[d]
            off[c] = total
            across += total * moved[c]
            far += total * total
            size += moved[c] * moved[c]
        if abs(across) > 1e-3 * math.sqrt(far * size):
            for c in range(n + m):
                for d in range(n + m):
                    curvature[c, d] += off[c] * off[d] / across


@inner
def add_curvature(horizon: Horizon, program: Program) -> None:
    """Add E' curvature_i E of all intervals to the Hessian, E (n + m, v) being the derivative of an interval's state
    and inputs by all inputs, and make it positive definite.
    """
    (count, n), m, v = horizon.linear.reached.shape, horizon.inputs.shape[1], program.gradient.shape[0]
    largest = 0.0
    for c in range(v):
        largest = max(largest, program.hessian[c, c])
    moved, bent = np.zeros((n + m, v)), np.zeros((n + m, v))
    hessian, e, t = pointer(program.hessian), pointer(moved), pointer(bent)
    input_response = pointer(horizon.condensed.input_response)
    for i in range(count):
        wide = (i + 1) * m
        for a in range(n):
            for c in range(i * m):
                e[a * v + c] = input_response[((i - 1) * n + a) * v + c]
            for c in range(i * m, wide):
                e[a * v + c] = 0.0
        for j in range(m):
            for c in range(wide):
                e[(n + j) * v + c] = 1.0 if c == i * m + j else 0.0
        for a in range(n + m):
            for c in range(wide):
                t[a * v + c] = 0.0
            for b in range(n + m):
                slope = horizon.lagrangian.curvature[i, a, b]
                for c in range(wide):
                    t[a * v + c] += slope * e[b * v + c]
        for a in range(n + m):
            for c in range(wide):
                slope, to = e[a * v + c], c * v
                if slope != 0.0:
                    for d in range(wide):
                        hessian[to + d] += slope * t[a * v + d]
    _make_positive(horizon, program, largest)


@inner
def _make_positive(horizon: Horizon, program: Program, largest: float) -> None:
    """Make the Hessian positive definite, if it is not, without changing it where inputs are free: by curvature across
    the active constraints (Nocedal & Wright 2006, section 17.3), and only where that leaves it indefinite, by a shift
    of its diagonal, which shortens all steps.
    """
    hessian, factor = program.hessian, np.empty_like(program.hessian)
    if _factorise(hessian, factor):
        return
    most = largest
    for c in range(hessian.shape[0]):
        most = max(most, abs(hessian[c, c]))
    _hold_active(horizon, program, HOLD * most)
    if _factorise(hessian, factor):
        return
    _price_active(horizon, program)
    if _factorise(hessian, factor):
        return
    shift = LEAST_SHIFT * largest
    for _ in range(60):  # one that is no number stays as it is
        for c in range(hessian.shape[0]):
            hessian[c, c] += shift
        if _factorise(hessian, factor):
            return
        shift *= 2.0


@inner
def _hold_active(horizon: Horizon, program: Program, hold: float) -> None:
    """Add curvature across the bounds and rate limits that the last solution met."""
    (count, m), v = horizon.inputs.shape, program.gradient.shape[0]
    for c in range(v):
        if program.multipliers[c] != 0.0:
            program.hessian[c, c] += hold
    for r in range(horizon.limits.rated.shape[0]):
        for i in range(count):
            if program.multipliers[v + r * count + i] != 0.0:
                c = i * m + horizon.limits.rated[r]
                program.hessian[c, c] += hold
                if i > 0:
                    program.hessian[c - m, c - m] += hold
                    program.hessian[c, c - m] -= hold
                    program.hessian[c - m, c] -= hold


@inner
def _price_active(horizon: Horizon, program: Program) -> None:
    """Add the curvature that their price has across the soft bounds that the last solution met. The program has it too,
    but outside of its Hessian, which must be positive alone; more would hold a state that is to move outside of them.
    """
    count, v = horizon.inputs.shape[0], program.gradient.shape[0]
    first, hessian, rows = v + horizon.limits.rated.shape[0] * count, pointer(program.hessian), pointer(program.rows)
    for r in range(horizon.limits.bounded.shape[0]):
        price = 2.0 * horizon.weights.quadratic[horizon.limits.bounded[r]]
        for i in range(count):
            if program.multipliers[first + r * count + i] != 0.0:
                row = (first - v + r * count + i) * v
                for c in range(v):
                    slope = price * rows[row + c]
                    if slope != 0.0:
                        for d in range(v):
                            hessian[c * v + d] += slope * rows[row + d]


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
