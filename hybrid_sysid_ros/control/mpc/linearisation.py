"""The model along a horizon in compiled code: ends of intervals, values of stages, and their derivatives."""

from __future__ import annotations

import math

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

PARALLEL = 1e-12
"""Share of a squared gradient that is left across others, below which they are parallel."""


@inner
def keep_hard(prediction: PredictionModel, horizon: Horizon, previous: Array, inputs: Array) -> None:
    """Move inputs (N, m) of each interval to where the hard bounds on terms hold, by Newton's method along the
    gradients of the inputs that are free to move: their bounds and limits of rates, after ``previous`` (m,), hold, too.

    Such terms depend on inputs alone. So every iterate keeps them, and a step needs no price of their violation.
    """
    (count, m), limits, first, drive = inputs.shape, horizon.limits, 0, horizon.work.drive
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
            if not _restore(horizon, i, u, low, high):
                break
    for i in range(count - 2, -1, -1):
        if limits.moves[i] == limits.moves[i + 1]:
            assign(inputs[i], inputs[i + 1])


@inner
def _restore(horizon: Horizon, i: int, u: Array, low: Array, high: Array) -> bool:
    """Move inputs u (m,) of interval i within low .. high by a step of Newton's method to the hard bounds that are off,
    and to those that the step would leave; False where none is off.

    The farthest is reached first, along its gradient by the inputs that are free; each further one along what its
    gradient has across those before (Gram and Schmidt), so that these stay. One after the other, bounds that meet at a
    small angle would hardly be approached.
    """
    limits, weights, linear, slopes = horizon.limits, horizon.weights, horizon.linear, horizon.work.slopes
    n, m, left = linear.C.shape[2], u.shape[0], False
    across, moved, one = np.zeros((m, m)), np.zeros(m), np.empty(m)
    for found in range(m):
        farthest, distance = -1, 0.0
        for r in range(limits.values.shape[0]):
            k = limits.values[r]
            value = linear.outputs[i, k]
            for j in range(m):
                value += slopes[k, n + j] * moved[j]
            above, below = value - weights.value_high[i, k], weights.value_low[i, k] - value
            if limits.hard[r] and max(above, below) > max(abs(distance), VIOLATION):
                farthest, distance = k, above if above > below else -below
        if farthest < 0:
            break
        left, whole, size = True, 0.0, 0.0
        for j in range(m):
            slope = slopes[farthest, n + j]
            one[j] = slope if ((u[j] > low[j]) if distance * slope > 0.0 else (u[j] < high[j])) else 0.0
            whole += one[j] * one[j]
        for e in range(found):
            part = 0.0
            for j in range(m):
                part += one[j] * across[e, j]
            for j in range(m):
                one[j] -= part * across[e, j]
        for j in range(m):
            size += one[j] * one[j]
        if not size > PARALLEL * whole:
            break
        for j in range(m):
            moved[j] -= distance * one[j] / size
            across[found, j] = one[j] / math.sqrt(size)
    for j in range(m if left else 0):
        u[j] = min(max(u[j] + moved[j], low[j]), high[j])
    return left
