"""The model along a horizon in compiled code: ends of intervals, values of stages, and their derivatives."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.stage_cost import StageWeights, excess, stage_cost
from hybrid_sysid_ros.core.call import call_jacobian, call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array


@inner
def assign(target: Array, values: Array) -> None:
    """Copy values. The compiler takes some seconds for target[:] = values, because of its error message."""
    for i in range(target.shape[0]):
        target[i] = values[i]


@inner
def assign_rows(values: Array, target: Array) -> None:
    """Copy rows of values."""
    for i in range(values.shape[0]):
        assign(target[i], values[i])


@inner
def advance_interval(prediction: PredictionModel, x: Array, drive: Array, following: Array) -> None:
    """Advance x (n,) by one interval, in the exact form."""
    p, w = prediction.parameters, prediction.network
    for _ in range(prediction.substeps):
        call_value(prediction.step, x, drive, p, w, prediction.h, 0.0, following)
        assign(x, following)


@inner
def follow(
    prediction: PredictionModel, weights: StageWeights, instance: Instance, inputs: Array, states: Array
) -> tuple[float, float]:
    """Simulate inputs (N, m) in the exact form into ``states`` (N + 1, n); return their cost, and the largest distance
    of a state from its bounds.
    """
    n, m = instance.state.shape[0], inputs.shape[1]
    values, staged = weights.outputs.shape[1], prediction.staged != 0
    drive, x, following = np.empty(2 * m + prediction.stage.shape[1]), np.empty(n), np.empty(n)
    y = np.empty(values)
    cost = largest = 0.0
    assign(x, instance.state)
    assign(states[0], x)
    for i in range(inputs.shape[0]):
        for j in range(m):
            drive[j] = inputs[i, j] + instance.disturbance[j]
        advance_interval(prediction, x, drive, following)
        if staged:
            set_stage(prediction, i, instance.disturbance, drive)
        call_value(prediction.output, x, drive, prediction.parameters, prediction.network, prediction.h, 0.0, y)
        assign(states[i + 1], x)
        before = instance.previous if i == 0 else inputs[i - 1]
        cost += stage_cost(weights, i, y, instance.preview[i], inputs[i], before, x)
        for a in range(n):
            largest = max(largest, excess(weights, i, a, x[a]))
    return cost, largest


@inner
def simulate(prediction: PredictionModel, horizon: Horizon) -> None:
    """Find states and outputs along the inputs as :func:`linearise` with single shooting does, without derivatives."""
    x, drive, following = horizon.work.state, horizon.work.drive, horizon.work.following
    p, w, h = prediction.parameters, prediction.network, prediction.h
    for i in range(horizon.inputs.shape[0]):
        set_out(horizon, i)
        for _ in range(prediction.substeps):
            call_value(prediction.smooth_step, x, drive, p, w, h, prediction.smoothing, following)
            assign(x, following)
        assign(horizon.states[i + 1], x)
        if prediction.staged != 0:
            set_stage(prediction, i, horizon.disturbance, drive)
        call_value(prediction.output, x, drive, p, w, h, 0.0, horizon.linear.outputs[i])


@inner
def linearise(prediction: PredictionModel, horizon: Horizon, smoothing: float, single: bool) -> None:
    """Linearise all intervals around the trajectory: reached, outputs, A, B, C, D.

    single: use single shooting, where each state is set to the end of the previous interval.
    """
    n, m = horizon.linear.B.shape[1:]
    for i in range(horizon.inputs.shape[0]):
        set_out(horizon, i)
        total = end_of_interval(prediction, horizon, smoothing, horizon.linear.reached[i])
        for a in range(n):
            for b in range(n):
                horizon.linear.A[i, a, b] = total[a, b]
            for j in range(m):
                horizon.linear.B[i, a, j] = total[a, n + j]
        if single:
            assign(horizon.states[i + 1], horizon.linear.reached[i])
        _evaluate(prediction, horizon, i)


@inner
def set_out(horizon: Horizon, i: int) -> None:
    """Set the state and the disturbed inputs of interval i, with which :func:`end_of_interval` begins."""
    x, drive = horizon.work.state, horizon.work.drive
    for a in range(horizon.states.shape[1]):
        x[a] = horizon.states[i, a]
    for j in range(horizon.inputs.shape[1]):
        drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]


@inner
def set_stage(prediction: PredictionModel, i: int, disturbance: Array, drive: Array) -> None:
    """Write what the terms of stage i need behind the inputs in ``drive``: the stage's parameters, the disturbance."""
    m, q = disturbance.shape[0], prediction.stage.shape[1]
    for c in range(q):
        drive[m + c] = prediction.stage[i, c]
    for j in range(m):
        drive[m + q + j] = disturbance[j]


@inner
def end_of_interval(prediction: PredictionModel, horizon: Horizon, smoothing: float, following: Array) -> Array:
    """Write the end of an interval to ``following`` (n,); return its [A, B], the first part of (n + m, padded)."""
    total, x, drive = horizon.work.total, horizon.work.state, horizon.work.drive
    address, p, w, h = prediction.step_jacobian, prediction.parameters, prediction.network, prediction.h
    for a in range(total.shape[0]):
        for c in range(total.shape[1]):
            total[a, c] = 1.0 if a == c else 0.0
    for step in range(prediction.substeps):
        if step > 0:
            assign(x, following)
        call_jacobian(address, x, drive, p, w, h, smoothing, following, total)
    return total


@inner
def _evaluate(prediction: PredictionModel, horizon: Horizon, i: int) -> None:
    """Compute the values of stage i, which begins with :func:`set_out`, and C and D."""
    n, m = horizon.linear.B.shape[1:]
    jacobian, drive = horizon.work.slopes, horizon.work.drive
    if prediction.staged != 0:
        set_stage(prediction, i, horizon.disturbance, drive)
    call_jacobian(
        prediction.output_jacobian, horizon.states[i + 1], drive, prediction.parameters, prediction.network,
        prediction.h, 0.0, horizon.linear.outputs[i], jacobian,
    )  # fmt: skip
    for k in range(horizon.linear.outputs.shape[1]):
        for b in range(n):
            horizon.linear.C[i, k, b] = jacobian[k, b]
        for j in range(m):
            horizon.linear.D[i, k, j] = jacobian[k, n + j]


RESTORATIONS, VIOLATION = 8, 1e-13
"""Most steps back to the hard bounds of a stage's terms, and the distance that is left."""


@inner
def keep_hard(prediction: PredictionModel, horizon: Horizon, previous: Array, inputs: Array) -> None:
    """Move inputs (N, m) of each interval to where the hard bounds on terms hold, by Newton's method along each
    gradient of the inputs that are free to move: their bounds and limits of rates, after ``previous`` (m,), hold, too.

    Such terms depend on inputs alone. So every iterate keeps them, and a step needs no price of their violation.
    """
    limits, weights, linear, slopes = horizon.limits, horizon.weights, horizon.linear, horizon.work.slopes
    n, m = linear.B.shape[1:]
    count, first, drive = inputs.shape[0], 0, horizon.work.drive
    low, high = np.empty(m), np.empty(m)
    for i in range(count):
        u = inputs[i]
        if i > 0 and limits.moves[i] == limits.moves[i - 1]:
            assign(u, inputs[i - 1])
        else:
            first = i
        before = inputs[first - 1] if first > 0 else previous
        for j in range(m):
            low[j] = max(limits.low[j], before[j] - limits.rate[j])
            high[j] = min(limits.high[j], before[j] + limits.rate[j])
        for _ in range(RESTORATIONS):
            for j in range(m):
                drive[j] = u[j] + horizon.disturbance[j]
            _evaluate(prediction, horizon, i)
            most = 0.0
            for r in range(limits.values.shape[0]):
                k = limits.values[r]
                above, below = (
                    linear.outputs[i, k] - weights.value_high[i, k],
                    weights.value_low[i, k] - linear.outputs[i, k],
                )
                if limits.hard[r] and max(above, below) > VIOLATION:
                    most = max(most, above, below)
                    _restore(u, slopes[k, n:], above if above > below else -below, low, high)
            if most == 0.0:
                break
    for i in range(count - 2, -1, -1):
        if limits.moves[i] == limits.moves[i + 1]:
            assign(inputs[i], inputs[i + 1])


@inner
def _restore(u: Array, slopes: Array, distance: float, low: Array, high: Array) -> None:
    """Move inputs u (m,) within low .. high against a distance of a value, whose derivatives by them are ``slopes``."""
    size = 0.0
    for j in range(u.shape[0]):
        if (u[j] > low[j]) if distance * slopes[j] > 0.0 else (u[j] < high[j]):
            size += slopes[j] * slopes[j]
    for j in range(u.shape[0] if size > 0.0 else 0):
        u[j] = min(max(u[j] - distance * slopes[j] / size, low[j]), high[j])
