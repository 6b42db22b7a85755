"""Quadratic forms along a horizon: their sum as a Hessian by all inputs, and Gauss-Newton's."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.chain_rule import LANES
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.registers import load_numbers, plus_scaled, store, zero

LEAST_CURVATURE = 1e-9
"""Share of the Hessian's largest entry, added to its diagonal in case inputs have no weight."""


@inner
def condense_hessian(horizon: Horizon, program: Program) -> None:
    """Compute the Gauss-Newton Hessian by the inputs, after :func:`condense_rows`."""
    (count, n), m, v = horizon.linear.reached.shape, horizon.inputs.shape[1], program.gradient.shape[0]
    weights, linear = horizon.weights, horizon.linear
    hessian, end, width = pointer(program.hessian), pointer(horizon.lagrangian.bend), n + m
    for c in range(v * v):
        hessian[c] = 0.0
    for c in range(count * width * width):
        end[c] = 0.0
    for i in range(count):
        for k in range(linear.outputs.shape[1]):
            for r in range(width if weights.outputs[i, k] != 0.0 else 0):
                slope = 2.0 * weights.outputs[i, k] * (linear.C[i, k, r] if r < n else linear.D[i, k, r - n])
                for c in range(width if slope != 0.0 else 0):
                    at = (i * width + r) * width + c
                    end[at] += slope * (linear.C[i, k, c] if c < n else linear.D[i, k, c - n])
    add_forms(horizon, program, False, True)
    _weigh_inputs(horizon, program)
    mirror_hessian(program)


@inner
def _weigh_inputs(horizon: Horizon, program: Program) -> None:
    """Add the weights of inputs and their changes, and the least curvature, to the lower half of the Hessian."""
    count, m = horizon.inputs.shape
    hessian, v, moves, weights = program.hessian, program.gradient.shape[0], horizon.limits.moves, horizon.weights
    largest = 0.0
    for i in range(count):
        new = i == 0 or moves[i] != moves[i - 1]
        for j in range(m):
            c = moves[i] * m + j
            hessian[c, c] += 2.0 * ((weights.rates[i, j] if new else 0.0) + weights.inputs[i, j])
            if i + 1 < count and moves[i + 1] != moves[i]:
                hessian[c, c] += 2.0 * weights.rates[i + 1, j]
                hessian[c + m, c] -= 2.0 * weights.rates[i + 1, j]
            largest = max(largest, hessian[c, c])
    for c in range(v):
        hessian[c, c] += LEAST_CURVATURE * largest


@inner
def add_forms(horizon: Horizon, program: Program, begins: bool, ends: bool) -> None:
    """Add quadratic forms of all intervals to the lower half of the Hessian by all inputs: ``curvature``, of the state
    and the inputs with which an interval begins, and ``bend``, of its inputs and the state at its end.

    Backward, by the form of all that follows: Frison & Jorgensen (2013), A fast condensing method for solution of
    linear-quadratic control problems, IEEE CDC.
    """
    linear, work = horizon.linear, horizon.work
    (count, n), m, v = linear.reached.shape, horizon.inputs.shape[1], program.gradient.shape[0]
    hessian, response, moves = pointer(program.hessian), pointer(linear.response), horizon.limits.moves
    form, slopes, ahead = pointer(work.form), pointer(work.total), pointer(work.ahead)
    by_state, by_input = pointer(linear.A), pointer(linear.B)
    begin, end = pointer(horizon.lagrangian.curvature), pointer(horizon.lagrangian.bend)
    width, stride, reach = n + m, work.form.shape[1], linear.response.shape[2]
    for c in range(width * stride):
        form[c] = 0.0
    for i in range(count - 1, -1, -1):
        own = i * width * width
        for a in range(n):
            for c in range(n):
                slopes[a * stride + c] = by_state[(i * n + a) * n + c]
                if ends:
                    form[a * stride + c] += end[own + a * width + c]
            for c in range(m):
                slopes[a * stride + n + c] = by_input[(i * n + a) * m + c]
        multiply(form, stride, 1, n, n, slopes, ahead, stride, stride)
        multiply(slopes, 1, stride, width, n, ahead, form, stride, stride)
        for r in range(width if begins else 0):
            for c in range(width):
                form[r * stride + c] += begin[own + r * width + c]
        for r in range(n, width if ends else n):
            for c in range(n, width):
                form[r * stride + c] += end[own + r * width + c]
            for a in range(n):
                factor = end[own + r * width + a]
                for c in range(width if factor != 0.0 else 0):
                    form[r * stride + c] += factor * slopes[a * stride + c]
                    if c >= n:
                        form[c * stride + r] += factor * slopes[a * stride + c]
        at, before = moves[i] * m, (moves[i - 1] + 1) * m if i > 0 else 0
        for j in range(m):
            to, row = (at + j) * v, (n + j) * stride
            for a in range(n):
                slope, first = form[row + a], ((i - 1) * n + a) * reach
                for c in range(min(before, at + j + 1)):
                    hessian[to + c] += slope * response[first + c]
            for k in range(j + 1):
                hessian[to + at + k] += form[row + n + k]
                for a in range(n if before > at else 0):  # inputs that are held are in the state, too
                    hessian[to + at + k] += form[(n + k) * stride + a] * response[((i - 1) * n + a) * reach + at + j]


@inner
def multiply(
    factors: Any, row: int, column: int, rows: int, count: int, by: Any, out: Any, stride: int, columns: int
) -> None:
    """Compute the first columns, a multiple of LANES, of out = F by. F_rk = factors[r row + k column], (rows, count).
    Rows of ``by`` and ``out`` are a ``stride`` apart.
    """
    whole = rows - rows % 4
    for j in range(0, columns, LANES):
        for r in range(0, whole, 4):
            a, b, c, d = zero(LANES), zero(LANES), zero(LANES), zero(LANES)
            for k in range(count):
                at, part = r * row + k * column, load_numbers(by, k * stride + j, LANES)
                a = plus_scaled(a, part, factors[at])
                b = plus_scaled(b, part, factors[at + row])
                c = plus_scaled(c, part, factors[at + 2 * row])
                d = plus_scaled(d, part, factors[at + 3 * row])
            store(out, r * stride + j, a)
            store(out, (r + 1) * stride + j, b)
            store(out, (r + 2) * stride + j, c)
            store(out, (r + 3) * stride + j, d)
        for r in range(whole, rows):
            a = zero(LANES)
            for k in range(count):
                a = plus_scaled(a, load_numbers(by, k * stride + j, LANES), factors[r * row + k * column])
            store(out, r * stride + j, a)


@inner
def mirror_hessian(program: Program) -> None:
    """Copy the lower half of the Hessian to the upper."""
    hessian, v = pointer(program.hessian), program.gradient.shape[0]
    for c in range(v):
        for d in range(c):
            hessian[d * v + c] = hessian[c * v + d]
