"""Quadratic forms along a horizon: their sum as a Hessian by all inputs."""

from __future__ import annotations

from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner


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
    form, slopes, ahead = work.form, work.total, work.moved
    for r in range(n + m):
        for c in range(n + m):
            form[r, c] = 0.0
    for i in range(count - 1, -1, -1):
        begin, end = horizon.lagrangian.curvature[i], horizon.lagrangian.bend[i]
        for a in range(n):
            for c in range(n + m):
                slopes[a, c] = linear.A[i, a, c] if c < n else linear.B[i, a, c - n]
        for a in range(n):
            for c in range(n + m):
                total = 0.0
                for b in range(n):
                    total += (form[a, b] + end[a, b] if ends else form[a, b]) * slopes[b, c]
                ahead[a, c] = total
        for r in range(n + m):
            for c in range(n + m):
                total = begin[r, c] if begins else 0.0
                for a in range(n):
                    total += slopes[a, r] * ahead[a, c]
                if ends and r >= n:
                    for a in range(n):
                        total += end[r, a] * slopes[a, c]
                        if c >= n:
                            total += end[c, a] * slopes[a, r]
                    if c >= n:
                        total += end[r, c]
                form[r, c] = total
        at, before = moves[i] * m, (moves[i - 1] + 1) * m if i > 0 else 0
        for j in range(m):
            to = (at + j) * v
            for a in range(n):
                slope, first = form[n + j, a], ((i - 1) * n + a) * v
                for c in range(min(before, at + j + 1)):
                    hessian[to + c] += slope * response[first + c]
            for k in range(j + 1):
                hessian[to + at + k] += form[n + j, n + k]
                for a in range(n if before > at else 0):  # inputs that are held are in the state, too
                    hessian[to + at + k] += form[n + k, a] * response[((i - 1) * n + a) * v + at + j]


@inner
def complete(program: Program) -> None:
    """Copy the lower half of the Hessian to the upper."""
    hessian, v = pointer(program.hessian), program.gradient.shape[0]
    for c in range(v):
        for d in range(c):
            hessian[d * v + c] = hessian[c * v + d]
