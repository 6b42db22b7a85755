"""The model along a horizon in compiled code: where intervals lead, their derivatives, and the curvature of those."""

from __future__ import annotations

from hybrid_sysid_ros.control.mpc.horizon import Horizon, Prediction
from hybrid_sysid_ros.core.call import call_slopes, call_value, pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

DIFFERENCE = 1e-7
"""Of states and inputs, to their size and at least to 1, by which derivatives are differentiated."""


@inner
def assign(target: Array, values: Array) -> None:
    """Copy values; the compiler takes some seconds over target[:] = values, for the message of its error."""
    for i in range(target.shape[0]):
        target[i] = values[i]


@inner
def advance(prediction: Prediction, x: Array, drive: Array, following: Array) -> None:
    """Move x (n,) one interval on, in the exact form."""
    p, w = prediction.parameters, prediction.network
    for _ in range(prediction.substeps):
        call_value(prediction.step, x, drive, p, w, prediction.h, 0.0, following)
        assign(x, following)


@inner
def linearise(prediction: Prediction, horizon: Horizon, smoothing: float, single: bool) -> None:
    """All intervals about the trajectory: reached, outputs, A, B, C, D.

    single: shooting once, each state being moved to where the interval before it ends.
    """
    n, m = horizon.linear.B.shape[1:]
    for i in range(horizon.inputs.shape[0]):
        _set_out(horizon, i)
        total = _interval(prediction, horizon, smoothing, horizon.linear.reached[i])
        for a in range(n):
            for b in range(n):
                horizon.linear.A[i, a, b] = total[a, b]
            for j in range(m):
                horizon.linear.B[i, a, j] = total[a, n + j]
        if single:
            assign(horizon.states[i + 1], horizon.linear.reached[i])
        _observe(prediction, horizon, i)


@inner
def _set_out(horizon: Horizon, i: int) -> None:
    """The state and the inputs with disturbance of interval i, where :func:`_interval` begins."""
    x, drive = horizon.work.state, horizon.work.drive
    for a in range(horizon.states.shape[1]):
        x[a] = horizon.states[i, a]
    for j in range(horizon.inputs.shape[1]):
        drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]


@inner
def _interval(prediction: Prediction, horizon: Horizon, smoothing: float, following: Array) -> Array:
    """Where an interval leads, into ``following`` (n,), and its [A, B] (n, n + m)."""
    n, m = horizon.linear.B.shape[1:]
    work = horizon.work
    total, moved, slopes, x, drive = work.total, work.moved, work.derivatives, work.state, work.drive
    address, p, w, h = prediction.step_slopes, prediction.parameters, prediction.network, prediction.h
    call_slopes(address, x, drive, p, w, h, smoothing, following, total)
    for _ in range(prediction.substeps - 1):
        for a in range(n):
            x[a] = following[a]
        call_slopes(address, x, drive, p, w, h, smoothing, following, slopes)
        _chain(slopes, total, moved, n, m)
        total, moved = moved, total
    return total


@inner
def _chain(slopes: Array, total: Array, moved: Array, n: int, m: int) -> None:
    """The chain rule over a step: moved = slopes_x total + [0, slopes_u], all (n, n + m)."""
    width = n + m
    f, t, o = pointer(slopes), pointer(total), pointer(moved)
    for a in range(n):
        for c in range(width):
            change = f[a * width + c] if c >= n else 0.0
            for b in range(n):
                change += f[a * width + b] * t[b * width + c]
            o[a * width + c] = change


@inner
def _observe(prediction: Prediction, horizon: Horizon, i: int) -> None:
    """The outputs at the end of interval i, and C and D."""
    n, m = horizon.linear.B.shape[1:]
    slopes, drive = horizon.work.derivatives, horizon.work.drive
    call_slopes(
        prediction.output_slopes, horizon.states[i + 1], drive, prediction.parameters, prediction.network,
        prediction.h, 0.0, horizon.linear.outputs[i], slopes,
    )  # fmt: skip
    for k in range(horizon.linear.outputs.shape[1]):
        for b in range(n):
            horizon.linear.C[i, k, b] = slopes[k, b]
        for j in range(m):
            horizon.linear.D[i, k, j] = slopes[k, n + j]


@inner
def find_curvature(prediction: Prediction, horizon: Horizon) -> None:
    """Second derivatives of each interval's end, weighed by its adjoint, by differences of [A, B]."""
    n, m = horizon.linear.B.shape[1:]
    x, drive, following = horizon.work.state, horizon.work.drive, horizon.work.following
    for i in range(horizon.inputs.shape[0]):
        curvature, adjoint = horizon.lagrangian.curvature[i], horizon.lagrangian.adjoint[i + 1]
        for r in range(n + m):
            _set_out(horizon, i)
            if r < n:
                h = DIFFERENCE * (1.0 + abs(x[r]))
                x[r] += h
            else:
                h = DIFFERENCE * (1.0 + abs(drive[r - n]))
                drive[r - n] += h
            total = _interval(prediction, horizon, prediction.smoothing, following)
            for c in range(n + m):
                slope = 0.0
                for a in range(n):
                    before = horizon.linear.A[i, a, c] if c < n else horizon.linear.B[i, a, c - n]
                    slope += adjoint[a] * (total[a, c] - before)
                curvature[r, c] = slope / h
        for r in range(n + m):
            for c in range(r):
                curvature[r, c] = curvature[c, r] = 0.5 * (curvature[r, c] + curvature[c, r])
