"""Condensing: states are eliminated from the quadratic program, and its solution gives the step of inputs and states.

Bock & Plitt (1984), IFAC World Congress.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.mpc.curvature import factor
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.stage_cost import StageWeights, stage_cost
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

LEAST_CURVATURE = 1e-9
"""Share of the Hessian's largest entry, added to its diagonal in case inputs have no weight."""

NO_BOUND = 1e30


@inner
def condense(horizon: Horizon, program: Program) -> None:
    """Compute states and outputs as functions of the inputs, the Gauss-Newton Hessian and the rows of bounds."""
    count, n = horizon.linear.reached.shape
    m, values, v = horizon.inputs.shape[1], horizon.linear.outputs.shape[1], program.gradient.shape[0]
    condensed, hessian = horizon.condensed, pointer(program.hessian)
    response, sensitivity = pointer(condensed.input_response), pointer(condensed.output_sensitivity)
    for c in range(v * v):
        hessian[c] = 0.0
    limits, weights = horizon.limits, horizon.weights
    for i in range(count):
        _propagate(horizon, i)
        at = limits.moves[i] * m
        wide = at + m
        for k in range(values):
            row, weight = (i * values + k) * v, 2.0 * weights.outputs[i, k]
            if not (weight != 0.0 or weights.prices[i, k] != 0.0 or _has_bound(weights, i, k)):
                continue
            for c in range(wide):
                sensitivity[row + c] = 0.0
            for a in range(n):
                slope, first = horizon.linear.C[i, k, a], (i * n + a) * v
                if slope != 0.0:
                    for c in range(wide):
                        sensitivity[row + c] += slope * response[first + c]
            for j in range(m):
                sensitivity[row + at + j] += horizon.linear.D[i, k, j]
            if weight != 0.0:
                for c in range(wide):
                    slope, to = weight * sensitivity[row + c], c * v
                    for d in range(c + 1):
                        hessian[to + d] += slope * sensitivity[row + d]
    _weigh_inputs(horizon, program)
    for r in range(limits.bounded.shape[0]):
        for i in range(count):
            row = limits.state_rows[r, i]
            for c in range((limits.moves[i] + 1) * m if row >= 0 else 0):
                program.rows[row, c] = condensed.input_response[i, limits.bounded[r], c]
    for r in range(limits.values.shape[0]):
        for i in range(count):
            row = limits.value_rows[r, i]
            for c in range((limits.moves[i] + 1) * m if row >= 0 else 0):
                program.rows[row, c] = condensed.output_sensitivity[i, limits.values[r], c]


@inner
def _has_bound(weights: StageWeights, i: int, k: int) -> bool:
    return weights.value_low[i, k] > -math.inf or weights.value_high[i, k] < math.inf


@inner
def _propagate(horizon: Horizon, i: int) -> None:
    """Compute state transition, input response and defect of an interval from those of the previous one."""
    linear, condensed = horizon.linear, horizon.condensed
    n, m, v = linear.A.shape[1], linear.B.shape[2], condensed.input_response.shape[2]
    response, at = pointer(condensed.input_response), horizon.limits.moves[i] * m
    before = (horizon.limits.moves[i - 1] + 1) * m if i > 0 else 0
    for a in range(n):
        total = linear.reached[i, a] - horizon.states[i + 1, a]
        if i > 0:
            for b in range(n):
                total += linear.A[i, a, b] * condensed.defect[i - 1, b]
        condensed.defect[i, a] = total
        for c in range(n):
            total = linear.A[i, a, c]
            if i > 0:
                total = 0.0
                for b in range(n):
                    total += linear.A[i, a, b] * condensed.state_transition[i - 1, b, c]
            condensed.state_transition[i, a, c] = total
        to = (i * n + a) * v
        for b in range(n):
            slope, first = linear.A[i, a, b], ((i - 1) * n + b) * v
            if b == 0:
                for c in range(before):
                    response[to + c] = slope * response[first + c]
            else:
                for c in range(before):
                    response[to + c] += slope * response[first + c]
        for c in range(before, at + m):
            response[to + c] = 0.0
        for j in range(m):
            response[to + at + j] += linear.B[i, a, j]


@inner
def _weigh_inputs(horizon: Horizon, program: Program) -> None:
    """Add the weights of inputs and their changes, and the least curvature, to the upper half of the Hessian."""
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
        for d in range(c):
            hessian[d, c] = hessian[c, d]


@inner
def cost_of(horizon: Horizon, instance: Instance) -> float:
    """Cost of the trajectory."""
    cost = 0.0
    for i in range(horizon.inputs.shape[0]):
        before = instance.previous if i == 0 else horizon.inputs[i - 1]
        cost += stage_cost(
            horizon.weights,
            i,
            horizon.linear.outputs[i],
            instance.preview[i],
            horizon.inputs[i],
            before,
            horizon.states[i + 1],
        )
    return cost


@inner
def evaluate_program(horizon: Horizon, program: Program, instance: Instance, off_instance: bool) -> None:
    """Compute gradient and bounds of the program for an instance. off_instance: the trajectory has gaps, or another
    initial state or disturbance than the instance.
    """
    count, n = horizon.linear.reached.shape
    m, p, v = horizon.inputs.shape[1], instance.preview.shape[1], program.gradient.shape[0]
    values = horizon.linear.outputs.shape[1]
    weights, inputs, gradient = horizon.weights, horizon.inputs, pointer(program.gradient)
    sensitivity = pointer(horizon.condensed.output_sensitivity)
    for c in range(v):
        gradient[c] = 0.0
    deviation = np.zeros(n)
    for i in range(count):
        before = instance.previous if i == 0 else inputs[i - 1]
        if off_instance:
            _predicted_deviation(horizon, instance, i, deviation)
        for k in range(values):
            error = horizon.linear.outputs[i, k]
            if k < p:
                error -= instance.preview[i, k]
            if off_instance:
                for a in range(n):
                    error += horizon.linear.C[i, k, a] * deviation[a]
                for j in range(m if k < p else 0):  # terms have the inputs without their disturbance
                    error += horizon.linear.D[i, k, j] * (instance.disturbance[j] - horizon.disturbance[j])
            slope, row = 2.0 * weights.outputs[i, k] * error, (i * values + k) * v
            if k >= p:
                slope += weights.prices[i, k]
            if slope != 0.0:
                for c in range((horizon.limits.moves[i] + 1) * m):
                    gradient[c] += slope * sensitivity[row + c]
        for j in range(m):
            _bound_input(horizon, program, i, j, inputs[i, j] - before[j])
        for r in range(horizon.limits.bounded.shape[0]):
            a = horizon.limits.bounded[r]
            expected = horizon.states[i + 1, a] + deviation[a]
            _bound_row(program, horizon.limits.state_rows[r, i], weights.low[i, a], weights.high[i, a], expected)
        for r in range(horizon.limits.values.shape[0]):
            k = horizon.limits.values[r]
            expected = horizon.linear.outputs[i, k]
            for a in range(n):
                expected += horizon.linear.C[i, k, a] * deviation[a]
            low, high = weights.value_low[i, k], weights.value_high[i, k]
            _bound_row(program, horizon.limits.value_rows[r, i], low, high, expected)


@inner
def _bound_row(program: Program, row: int, low: float, high: float, expected: float) -> None:
    """Set the bounds of a row to what is left of them where a value is expected."""
    if row >= 0:
        v = program.gradient.shape[0]
        program.lower[v + row] = max(low - expected, -NO_BOUND)
        program.upper[v + row] = min(high - expected, NO_BOUND)


@inner
def correct_bounds(horizon: Horizon, program: Program) -> bool:
    """Set the bounds of states and values to what is left of them at the end of the program's step, where the model was
    simulated, as if it were linear; False where none of them is active.
    """
    count, v, limits, weights = horizon.inputs.shape[0], program.gradient.shape[0], horizon.limits, horizon.weights
    rows, states, values = pointer(program.rows), limits.bounded.shape[0], limits.values.shape[0]
    active = False
    for r in range(states + values):
        for i in range(count):
            row = limits.state_rows[r, i] if r < states else limits.value_rows[r - states, i]
            if row < 0:
                continue
            active = active or program.multipliers[v + row] != 0.0
            if r < states:
                a = limits.bounded[r]
                found, low, high = horizon.states[i + 1, a], weights.low[i, a], weights.high[i, a]
            else:
                k = limits.values[r - states]
                found, low, high = horizon.linear.outputs[i, k], weights.value_low[i, k], weights.value_high[i, k]
            for c in range(v):
                found -= rows[row * v + c] * program.solution[c]
            _bound_row(program, row, low, high, found)
    return active


@inner
def _bound_input(horizon: Horizon, program: Program, i: int, j: int, change: float) -> None:
    """Set the bounds of one input and its change, and their parts of the gradient."""
    m, limits, weights, u = horizon.inputs.shape[1], horizon.limits, horizon.weights, horizon.inputs[i, j]
    c, slope = limits.moves[i] * m + j, 2.0 * weights.rates[i, j] * change
    program.gradient[c] += slope + 2.0 * weights.inputs[i, j] * (u - weights.rest[j])
    if i > 0:
        program.gradient[limits.moves[i - 1] * m + j] -= slope
    program.lower[c] = limits.low[j] - u
    program.upper[c] = limits.high[j] - u
    for r in range(limits.rated.shape[0]):
        if limits.rated[r] == j:
            _bound_row(program, limits.rate_rows[r, i], -limits.rate[j], limits.rate[j], change)


@inner
def _predicted_deviation(horizon: Horizon, instance: Instance, i: int, deviation: Array) -> None:
    """Write the deviation (n,) of the states at the end of an interval from the trajectory, for unchanged inputs."""
    n, m = horizon.linear.B.shape[1:]
    for a in range(n):
        total = horizon.condensed.defect[i, a]
        for b in range(n):
            total += horizon.condensed.state_transition[i, a, b] * (instance.state[b] - horizon.states[0, b])
        for j in range(m):
            shifted = instance.disturbance[j] - horizon.disturbance[j]
            if shifted != 0.0:
                for k in range(horizon.limits.moves[i] + 1):
                    total += horizon.condensed.input_response[i, a, k * m + j] * shifted
        deviation[a] = total


@inner
def residual(program: Program) -> float:
    """The KKT residual with the last multipliers: the largest entry of the Lagrangian's gradient."""
    v = program.gradient.shape[0]
    largest = 0.0
    for c in range(v):
        total = program.gradient[c] + program.multipliers[c]
        for r in range(program.rows.shape[0]):
            total += program.rows[r, c] * program.multipliers[v + r]
        largest = max(largest, abs(total))
    return largest


@inner
def find_adjoint(horizon: Horizon, program: Program, instance: Instance) -> None:
    """Compute the derivatives of the Lagrangian by each state of the trajectory, where later states follow."""
    count, n = horizon.linear.reached.shape
    v = program.gradient.shape[0]
    for a in range(n):
        horizon.lagrangian.adjoint[count, a] = 0.0
    for i in range(count - 1, -1, -1):
        after = horizon.lagrangian.adjoint[i + 1]
        for k in range(horizon.linear.outputs.shape[1]):
            slope = factor(horizon, program, instance, i, k)
            for a in range(n):
                after[a] += slope * horizon.linear.C[i, k, a]
        for r in range(horizon.limits.bounded.shape[0]):
            row = horizon.limits.state_rows[r, i]
            if row >= 0:
                after[horizon.limits.bounded[r]] += program.multipliers[v + row]
        for b in range(n):
            total = 0.0
            for a in range(n):
                total += horizon.linear.A[i, a, b] * after[a]
            horizon.lagrangian.adjoint[i, b] = total


@inner
def expand(horizon: Horizon, program: Program, instance: Instance) -> float:
    """Compute the step of inputs and states from a solution of the program; return the predicted cost."""
    linear, step = horizon.linear, horizon.step
    (count, n), m, values, p = (
        linear.reached.shape,
        horizon.inputs.shape[1],
        linear.outputs.shape[1],
        instance.preview.shape[1],
    )
    y, u, before, x = np.empty(values), np.empty(m), np.empty(m), np.empty(n)
    cost = 0.0
    for j in range(m):
        before[j] = instance.previous[j]
    for a in range(n):
        step.states[0, a] = instance.state[a] - horizon.states[0, a]
    for i in range(count):
        for j in range(m):
            step.inputs[i, j] = program.solution[horizon.limits.moves[i] * m + j]
            u[j] = horizon.inputs[i, j] + step.inputs[i, j]
        for a in range(n):
            total = linear.reached[i, a] - horizon.states[i + 1, a]
            for j in range(m):
                shifted = instance.disturbance[j] - horizon.disturbance[j]
                total += linear.B[i, a, j] * (step.inputs[i, j] + shifted)
            for b in range(n):
                total += linear.A[i, a, b] * step.states[i, b]
            step.states[i + 1, a] = total
            x[a] = horizon.states[i + 1, a] + total
        for k in range(values):
            y[k] = linear.outputs[i, k]
            for a in range(n):
                y[k] += linear.C[i, k, a] * step.states[i + 1, a]
            for j in range(m):
                shifted = instance.disturbance[j] if k < p else horizon.disturbance[j]
                y[k] += linear.D[i, k, j] * (step.inputs[i, j] + shifted - horizon.disturbance[j])
        cost += stage_cost(horizon.weights, i, y, instance.preview[i], u, before, x)
        for j in range(m):
            before[j] = u[j]
    return cost


@inner
def apply_step(horizon: Horizon, length: float) -> None:
    """Move inputs and states along the step."""
    for i in range(horizon.inputs.shape[0]):
        for j in range(horizon.inputs.shape[1]):
            horizon.inputs[i, j] += length * horizon.step.inputs[i, j]
    for i in range(horizon.states.shape[0]):
        for a in range(horizon.states.shape[1]):
            horizon.states[i, a] += length * horizon.step.states[i, a]
