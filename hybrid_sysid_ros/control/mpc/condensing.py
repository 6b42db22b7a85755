"""Condensing: states are eliminated from the quadratic program, and its solution gives the step of inputs and states.

Bock & Plitt (1984), IFAC World Congress.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.mpc.forms import condense_hessian, multiply
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.stage_cost import stage_cost
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.chain_rule import padded
from hybrid_sysid_ros.core.compilation import inner

NO_BOUND = 1e30


@inner
def condense(horizon: Horizon, program: Program) -> None:
    """Compute the states as functions of the inputs, the rows of bounds and the Gauss-Newton Hessian."""
    condense_rows(horizon, program)
    condense_hessian(horizon, program)


@inner
def condense_rows(horizon: Horizon, program: Program) -> None:
    """Compute the states as functions of the inputs, and the rows of bounds."""
    limits, linear = horizon.limits, horizon.linear
    (count, n), m = linear.reached.shape, horizon.inputs.shape[1]
    for i in range(count):
        _propagate(horizon, i)
        wide = (limits.moves[i] + 1) * m
        for r in range(limits.bounded.shape[0]):
            row = limits.state_rows[r, i]
            for c in range(wide if row >= 0 else 0):
                program.rows[row, c] = linear.response[i, limits.bounded[r], c]
        for r in range(limits.values.shape[0]):
            row, k = limits.value_rows[r, i], limits.values[r]
            for c in range(wide if row >= 0 else 0):
                program.rows[row, c] = linear.D[i, k, c - wide + m] if c >= wide - m else 0.0
            for a in range(n):
                slope = linear.C[i, k, a]
                for c in range(wide if row >= 0 and slope != 0.0 else 0):
                    program.rows[row, c] += slope * linear.response[i, a, c]


@inner
def _propagate(horizon: Horizon, i: int) -> None:
    """Compute the input response of an interval from that of the previous one."""
    linear = horizon.linear
    n, m, reach = linear.A.shape[1], linear.B.shape[2], linear.response.shape[2]
    own, at = pointer(linear.response[i]), horizon.limits.moves[i] * m
    before = (horizon.limits.moves[i - 1] + 1) * m if i > 0 else 0
    if i > 0:
        multiply(pointer(linear.A[i]), n, 1, n, n, pointer(linear.response[i - 1]), own, reach, padded(before))
    for a in range(n):
        for c in range(before, at + m):
            own[a * reach + c] = 0.0
        for j in range(m):
            own[a * reach + at + j] += linear.B[i, a, j]


@inner
def cost_of(horizon: Horizon, instance: Instance) -> float:
    """Cost of the trajectory."""
    cost = 0.0
    for i in range(horizon.inputs.shape[0]):
        cost += _cost_of_stage(horizon, instance, i)
    return cost


@inner
def _cost_of_stage(horizon: Horizon, instance: Instance, i: int) -> float:
    """Cost of stage i of the trajectory."""
    y, u, x = horizon.linear.outputs[i], horizon.inputs[i], horizon.states[i + 1]
    before = instance.previous if i == 0 else horizon.inputs[i - 1]
    return stage_cost(horizon.weights, i, y, instance.preview[i], u, before, x)  # type: ignore[no-any-return]


@inner
def evaluate_program(horizon: Horizon, program: Program, instance: Instance, off_instance: bool) -> None:
    """Compute gradient and bounds of the program for an instance. off_instance: the trajectory has gaps, or another
    initial state or disturbance than the instance.
    """
    count, n = horizon.linear.reached.shape
    m, p, v = horizon.inputs.shape[1], instance.preview.shape[1], program.gradient.shape[0]
    linear, limits, weights, inputs = horizon.linear, horizon.limits, horizon.weights, horizon.inputs
    gradient, adjoint = pointer(program.gradient), horizon.lagrangian.adjoint
    for c in range(v):
        gradient[c] = 0.0
    for a in range(n):
        adjoint[count, a] = 0.0
    if off_instance:
        for i in range(count):
            for j in range(m):
                horizon.step.inputs[i, j] = 0.0
        _move_states(horizon, instance)
    for i in range(count - 1, -1, -1):
        before, at = instance.previous if i == 0 else inputs[i - 1], limits.moves[i] * m
        after, deviation = adjoint[i + 1], horizon.step.states[i + 1]
        for k in range(linear.outputs.shape[1]):
            error = _expected(horizon, instance, i, k) if off_instance else linear.outputs[i, k]
            if k < p:
                error -= instance.preview[i, k]
            slope = 2.0 * weights.outputs[i, k] * error
            if k >= p:
                slope += weights.prices[i, k]
            if slope != 0.0:
                for a in range(n):
                    after[a] += slope * linear.C[i, k, a]
                for j in range(m):
                    gradient[at + j] += slope * linear.D[i, k, j]
        for j in range(m):
            for a in range(n):
                gradient[at + j] += linear.B[i, a, j] * after[a]
            _bound_input(horizon, program, i, j, inputs[i, j] - before[j])
        for b in range(n):
            total = 0.0
            for a in range(n):
                total += linear.A[i, a, b] * after[a]
            adjoint[i, b] = total
        for r in range(limits.bounded.shape[0]):
            a = limits.bounded[r]
            expected = horizon.states[i + 1, a] + (deviation[a] if off_instance else 0.0)
            _bound_row(program, limits.state_rows[r, i], weights.low[i, a], weights.high[i, a], expected)
        for r in range(limits.values.shape[0]):
            k = limits.values[r]
            expected = _expected(horizon, instance, i, k) if off_instance else linear.outputs[i, k]
            low, high = weights.value_low[i, k], weights.value_high[i, k]
            _bound_row(program, limits.value_rows[r, i], low, high, expected)


@inner
def _expected(horizon: Horizon, instance: Instance, i: int, k: int) -> float:
    """Value k of stage i where the states are moved by the step and the disturbance is the instance's."""
    total = horizon.linear.outputs[i, k]
    for a in range(horizon.states.shape[1]):
        total += horizon.linear.C[i, k, a] * horizon.step.states[i + 1, a]
    for j in range(instance.disturbance.shape[0] if k < instance.preview.shape[1] else 0):
        # terms have the inputs without their disturbance
        total += horizon.linear.D[i, k, j] * (instance.disturbance[j] - horizon.disturbance[j])
    return total


@inner
def _move_states(horizon: Horizon, instance: Instance) -> None:
    """Compute the step of the states to which the instance and the step of the inputs lead by the linear model."""
    linear, step = horizon.linear, horizon.step
    n, m = linear.B.shape[1:]
    for a in range(n):
        step.states[0, a] = instance.state[a] - horizon.states[0, a]
    for i in range(horizon.inputs.shape[0]):
        for a in range(n):
            total = linear.reached[i, a] - horizon.states[i + 1, a]
            for j in range(m):
                shifted = instance.disturbance[j] - horizon.disturbance[j]
                total += linear.B[i, a, j] * (step.inputs[i, j] + shifted)
            for b in range(n):
                total += linear.A[i, a, b] * step.states[i, b]
            step.states[i + 1, a] = total


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
def factor(horizon: Horizon, program: Program, instance: Instance, i: int, k: int) -> float:
    """The factor of value k of stage i in the Lagrangian, with the last multipliers."""
    v, p = program.gradient.shape[0], instance.preview.shape[1]
    error = horizon.linear.outputs[i, k]
    if k < p:
        error -= instance.preview[i, k]
    total = 2.0 * horizon.weights.outputs[i, k] * error
    if k >= p:
        total += horizon.weights.prices[i, k]
        for r in range(horizon.limits.values.shape[0]):
            if horizon.limits.values[r] == k and horizon.limits.value_rows[r, i] >= 0:
                total += program.multipliers[v + horizon.limits.value_rows[r, i]]
    return total


@inner
def residual(program: Program) -> float:
    """The KKT residual with the last multipliers: the largest entry of the Lagrangian's gradient; infinite where one is
    no number.
    """
    v, rows = program.gradient.shape[0], pointer(program.rows)
    total, largest = np.empty(v), 0.0
    for c in range(v):
        total[c] = program.gradient[c] + program.multipliers[c]
    for r in range(program.rows.shape[0]):
        multiplier = program.multipliers[v + r]
        for c in range(v if multiplier != 0.0 else 0):
            total[c] += rows[r * v + c] * multiplier
    for c in range(v):
        largest = max(largest, abs(total[c]) if math.isfinite(total[c]) else math.inf)
    return largest


@inner
def find_adjoint(horizon: Horizon, program: Program, instance: Instance) -> None:
    """Compute the derivatives of the Lagrangian by each state of the trajectory, where later states follow.

    Without bounds of states and values they are those of the cost, which :func:`evaluate_program` has found.
    """
    if horizon.limits.bounded.shape[0] + horizon.limits.values.shape[0] == 0:
        return
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
def expand(horizon: Horizon, program: Program, instance: Instance) -> tuple[float, float]:
    """Compute the step of inputs and states from a solution of the program; return the cost that it predicts, and the
    sum of the changes of all stages' costs by it, each without its sign.
    """
    linear, step = horizon.linear, horizon.step
    (count, n), m, values = linear.reached.shape, horizon.inputs.shape[1], linear.outputs.shape[1]
    y, u, before, x = np.empty(values), np.empty(m), np.empty(m), np.empty(n)
    cost = change = 0.0
    for i in range(count):
        for j in range(m):
            step.inputs[i, j] = program.solution[horizon.limits.moves[i] * m + j]
    _move_states(horizon, instance)
    for j in range(m):
        before[j] = instance.previous[j]
    for i in range(count):
        for j in range(m):
            u[j] = horizon.inputs[i, j] + step.inputs[i, j]
        for a in range(n):
            x[a] = horizon.states[i + 1, a] + step.states[i + 1, a]
        for k in range(values):
            y[k] = _expected(horizon, instance, i, k)
            for j in range(m):
                y[k] += linear.D[i, k, j] * step.inputs[i, j]
        moved = stage_cost(horizon.weights, i, y, instance.preview[i], u, before, x)
        cost += moved
        change += abs(moved - _cost_of_stage(horizon, instance, i))
        for j in range(m):
            before[j] = u[j]
    return cost, change


@inner
def apply_step(horizon: Horizon, length: float) -> None:
    """Move inputs and states along the step."""
    for i in range(horizon.inputs.shape[0]):
        for j in range(horizon.inputs.shape[1]):
            horizon.inputs[i, j] += length * horizon.step.inputs[i, j]
    for i in range(horizon.states.shape[0]):
        for a in range(horizon.states.shape[1]):
            horizon.states[i, a] += length * horizon.step.states[i, a]
