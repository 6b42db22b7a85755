"""The Lagrangian's Hessian along a horizon: where Gauss-Newton's is not enough, the curvature of the dynamics, and of
the terms of stages, is added and kept positive.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.condensing import factor
from hybrid_sysid_ros.control.mpc.eigenvalues import find_lack
from hybrid_sysid_ros.control.mpc.forms import add_forms, mirror_hessian
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.linearisation import assign_rows, end_of_interval, set_out, set_stage
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.core.call import call_value, pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

DIFFERENCE = 1e-7
"""Relative difference of states and inputs, absolute below 1, for second derivatives."""


@inner
def find_curvature(prediction: PredictionModel, horizon: Horizon) -> None:
    """Compute second derivatives of each interval's end, weighted by its adjoint, by differences of [A, B]."""
    n, m = horizon.linear.B.shape[1:]
    x, drive, following = horizon.work.state, horizon.work.drive, horizon.work.following
    for i in range(horizon.inputs.shape[0]):
        curvature, adjoint = horizon.lagrangian.curvature[i], horizon.lagrangian.adjoint[i + 1]
        for r in range(n + m):
            set_out(horizon, i)
            if r < n:
                h = DIFFERENCE * (1.0 + abs(x[r]))
                x[r] += h
            else:
                h = DIFFERENCE * (1.0 + abs(drive[r - n]))
                drive[r - n] += h
            total = end_of_interval(prediction, horizon, prediction.smoothing, following)
            for c in range(n + m):
                slope = 0.0
                for a in range(n):
                    before = horizon.linear.A[i, a, c] if c < n else horizon.linear.B[i, a, c - n]
                    slope += adjoint[a] * (total[a, c] - before)
                curvature[r, c] = slope / h
        for r in range(n + m):
            for c in range(r):
                curvature[r, c] = curvature[c, r] = 0.5 * (curvature[r, c] + curvature[c, r])


@inner
def bend_values(prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance) -> bool:
    """Compute the second derivatives of each stage's values, weighted by their factors in the Lagrangian; return
    whether one is not zero.
    """
    count, m = horizon.inputs.shape
    drive, values = horizon.work.drive, horizon.linear.outputs.shape[1]
    first = m + prediction.stage.shape[1] + m
    for i in range(count):
        set_out(horizon, i)
        set_stage(prediction, i, horizon.disturbance, drive)
        for k in range(values):
            drive[first + k] = factor(horizon, program, instance, i, k)
        call_value(
            prediction.curvature, horizon.states[i + 1], drive, prediction.parameters, prediction.network,
            prediction.h, 0.0, horizon.lagrangian.bend[i],
        )  # fmt: skip
    found, bend = False, pointer(horizon.lagrangian.bend)
    for c in range(horizon.lagrangian.bend.size):
        found = found or bend[c] != 0.0
    return found


LEAST_SHIFT = 1e-4
"""First shift of the diagonal of a Hessian that is not positive definite, relative to Gauss-Newton's largest entry. It
is doubled until the Hessian is: a larger shift would make steps short, a much smaller one would take many trials.
"""

HOLD = 100.0
"""Curvature across active constraints, relative to the largest entry of a Hessian that is not positive definite, which
far from the reference is much larger than Gauss-Newton's.
"""


SETTLED = 1
"""Most constraints that come into the working set of a step or leave it where the active ones are taken for those of
the solution.
"""


@inner
def keep_derivatives(horizon: Horizon) -> None:
    """Keep [A, B] and their iterate for :func:`update_curvature`."""
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
    """Symmetric rank-one update of each interval's curvature from the change of its [A, B] over the last step.

    Conn, Gould & Toint (1991), Mathematical Programming 50. For single intervals a few steps determine it.
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
def add_curvature(horizon: Horizon, program: Program, bending: bool) -> None:
    """Add the curvature of all intervals to the Hessian, and make it positive definite. bending: also that of the
    values, at their ends.
    """
    largest, factor = 0.0, np.empty_like(program.hessian)
    for c in range(program.gradient.shape[0]):
        largest = max(largest, program.hessian[c, c])
    add_forms(horizon, program, True, bending)
    mirror_hessian(program)
    if _factorise(program.hessian, factor):
        return
    if horizon.progress[0].changed > SETTLED:
        _make_convex(horizon, program, bending)
    if not _factorise(program.hessian, factor):
        _make_positive(horizon, program, largest)


@inner
def _make_convex(horizon: Horizon, program: Program, bending: bool) -> None:
    """Add to the Hessian what the curvature of each interval lacks to be positive semidefinite: the bounds that are
    active say nothing yet about where inputs will be free.
    """
    curvature, bend, kept = horizon.lagrangian.curvature, horizon.lagrangian.bend, horizon.lagrangian.kept
    for i in range(curvature.shape[0]):
        assign_rows(curvature[i], kept[i])
        find_lack(curvature[i])
        if bending:
            find_lack(bend[i])
    add_forms(horizon, program, True, bending)
    mirror_hessian(program)
    for i in range(curvature.shape[0]):
        assign_rows(kept[i], curvature[i])


@inner
def _make_positive(horizon: Horizon, program: Program, largest: float) -> None:
    """Make a Hessian that is not positive definite so, without changing it where inputs are free: by curvature across
    the active constraints (Nocedal & Wright 2006, section 17.3), and, only where it is still indefinite, by a shift of
    its diagonal, which shortens all steps.
    """
    hessian, factor = program.hessian, np.empty_like(program.hessian)
    hold = HOLD * largest
    for c in range(hessian.shape[0]):
        hold = max(hold, HOLD * abs(hessian[c, c]))
    _hold_active(horizon, program, hold)
    if _factorise(hessian, factor):
        return
    _price_active(horizon, program, 0.0, hold)
    if _factorise(hessian, factor):
        return
    _price_active(horizon, program, hold, math.inf)
    if _factorise(hessian, factor):
        return
    shift = LEAST_SHIFT * largest
    for _ in range(60):  # a NaN Hessian stays as it is
        for c in range(hessian.shape[0]):
            hessian[c, c] += shift
        if _factorise(hessian, factor):
            return
        shift *= 2.0


@inner
def _hold_active(horizon: Horizon, program: Program, hold: float) -> None:
    """Add curvature across the bounds and rate limits that are active in the last solution."""
    v, limits = program.gradient.shape[0], horizon.limits
    for c in range(v):
        if program.multipliers[c] != 0.0:
            program.hessian[c, c] += hold
    for r in range(limits.rated.shape[0]):
        _price_rows(program, limits.rate_rows[r], hold, 0.0, math.inf)
    for r in range(limits.values.shape[0]):
        if limits.hard[r]:
            _price_rows(program, limits.value_rows[r], hold, 0.0, math.inf)


@inner
def _price_active(horizon: Horizon, program: Program, least: float, most: float) -> None:
    """Add the curvature of the price across the soft bounds that are active in the last solution. The program has it
    outside its Hessian, which must be positive definite alone; more would hold a state outside the bounds. Of each row
    as much as is between ``least`` and ``most``: where the whole price is many times the Hessian, little but rounding
    is left of the curvature along the bounds.
    """
    limits, weights = horizon.limits, horizon.weights
    for r in range(limits.bounded.shape[0]):
        _price_rows(program, limits.state_rows[r], 2.0 * weights.quadratic[limits.bounded[r]], least, most)
    for r in range(limits.values.shape[0]):
        if not limits.hard[r]:
            price = 2.0 * weights.value_quadratic[limits.values[r]]
            _price_rows(program, limits.value_rows[r], price, least, most)


@inner
def _price_rows(program: Program, numbers: NDArray[np.int64], price: float, least: float, most: float) -> None:
    """Add price r'r to the Hessian for each row r of the program that is active, out of those of some numbers: the part
    of the curvature price |r|^2 along the row that is between ``least`` and ``most``.
    """
    v, hessian, rows = program.gradient.shape[0], pointer(program.hessian), pointer(program.rows)
    for i in range(numbers.shape[0]):
        if numbers[i] >= 0 and program.multipliers[v + numbers[i]] != 0.0:
            row, size = numbers[i] * v, 0.0
            for c in range(v):
                size += rows[row + c] * rows[row + c]
            part = min(price * size, most) - min(price * size, least)
            for c in range(v if part > 0.0 else 0):
                slope = part / size * rows[row + c]
                if slope != 0.0:
                    for d in range(v):
                        hessian[c * v + d] += slope * rows[row + d]


@inner
def _factorise(hessian: Array, factor: Array) -> bool:
    """Cholesky's upper factor; False where a matrix is not positive definite."""
    v = hessian.shape[0]
    h, f = pointer(hessian), pointer(factor)
    for c in range(v):
        for d in range(c, v):
            f[c * v + d] = h[c * v + d]
        for k in range(c):
            slope = f[k * v + c]
            for d in range(c, v):
                f[c * v + d] -= slope * f[k * v + d]
        if not f[c * v + c] > 0.0:
            return False
        scale = 1.0 / math.sqrt(f[c * v + c])
        for d in range(c, v):
            f[c * v + d] *= scale
    return True
