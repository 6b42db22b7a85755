"""The horizon of multiple shooting: a trajectory, the quadratic program about it, and the step to its solution.

Condensing: Bock & Plitt (1984), IFAC World Congress.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, STATES, Program
from hybrid_sysid_ros.core import compilation

Array = NDArray[np.float64]

OPTIONS: dict[str, Any] = {**compilation.OPTIONS, "fastmath": {"contract"}}
"""Of compiled code here and where the equation comes in."""

inner = register_jitable(**OPTIONS)
cached_inner = register_jitable(cache=True, **OPTIONS)
"""See :data:`~hybrid_sysid_ros.core.compilation.inner`; the cached ones know nothing of the equation."""

LEAST_CURVATURE = 1e-9
"""Added to the Hessian's diagonal, in shares of its largest entry: inputs without weight must not make it singular."""

STEEPEST = 1000.0
"""Curvature, in that of the Hessian, that no step may teach: it comes from corners, not from curves."""

SECANTS = 8
"""Steps of one solution that the Hessian learns from before it begins anew."""


class Question(NamedTuple):
    """What changes from call to call: initial state (states,), input disturbance (1,), the input before (1,) and the
    reference of the output (horizon,) in its own unit.
    """

    state: Array
    disturbance: Array
    previous: Array
    reference: Array


class Horizon(NamedTuple):
    """A trajectory and the problem linearised about it; N = horizon, n = states.

    states (N + 1, n), inputs (N,), disturbance (1,). A (N, n, n), B (N, n, 1): derivatives of each interval; reached
    (N, n): where it ends. With an initial state e off, inputs v off and the trajectory's own gaps the states are off by
    free_i e + driven_i v + forced_i:  free (N, n, n), driven (N, n, N), forced (N, n).
    output: the state that is tracked. weights (3, N): of outputs, input changes and inputs. input_limit, rate_limit:
    of inputs and their changes. bounded: states with bounds, lower and upper (n,), and the
    price (2,) of s outside: price_0 s + price_1 s^2.
    step (N,): the inputs' last step, moved (N + 1, n): the states'. secants (2, SECANTS, N): steps of this solution
    and how the gradient changed, learnt (1,): how many there were. rows: memory of the linearisation.
    """

    states: Array
    inputs: Array
    disturbance: Array
    A: Array
    B: Array
    reached: Array
    free: Array
    driven: Array
    forced: Array
    output: int
    weights: Array
    input_limit: float
    rate_limit: float
    bounded: NDArray[np.int64]
    lower: Array
    upper: Array
    price: Array
    step: Array
    moved: Array
    secants: Array
    learnt: NDArray[np.int64]
    rows: Array


@cached_inner
def assign(target: Array, values: Array) -> None:
    """target[:] = values; the compiler takes some seconds over that notation, for the message of its error."""
    for i in range(target.shape[0]):
        target[i] = values[i]


@cached_inner
def condense(horizon: Horizon, program: Program) -> None:
    """States as functions of the inputs, and with them the Hessian and the rows of the bounded states."""
    count, states = horizon.reached.shape
    A, B, free, driven, forced = horizon.A, horizon.B, horizon.free, horizon.driven, horizon.forced
    hessian = program.hessian
    hessian[:] = 0.0
    output = horizon.output
    for i in range(count):
        for a in range(states):
            total = horizon.reached[i, a] - horizon.states[i + 1, a]
            if i > 0:
                for b in range(states):
                    total += A[i, a, b] * forced[i - 1, b]
            forced[i, a] = total
            for c in range(states):
                if i == 0:
                    free[i, a, c] = A[i, a, c]
                else:
                    total = 0.0
                    for b in range(states):
                        total += A[i, a, b] * free[i - 1, b, c]
                    free[i, a, c] = total
            for j in range(i):
                driven[i, a, j] = A[i, a, 0] * driven[i - 1, 0, j]
            for b in range(1, states):
                for j in range(i):
                    driven[i, a, j] += A[i, a, b] * driven[i - 1, b, j]
            driven[i, a, i] = B[i, a, 0]
        row = driven[i, output]
        weight = 2.0 * horizon.weights[0, i]
        for j in range(i + 1):
            slope = weight * row[j]
            for k in range(j + 1):
                hessian[j, k] += slope * row[k]
    largest = 0.0
    for j in range(count):
        hessian[j, j] += 2.0 * (horizon.weights[1, j] + horizon.weights[2, j])
        if j + 1 < count:
            hessian[j, j] += 2.0 * horizon.weights[1, j + 1]
            hessian[j + 1, j] -= 2.0 * horizon.weights[1, j + 1]
        largest = max(largest, hessian[j, j])
    for j in range(count):
        hessian[j, j] += LEAST_CURVATURE * largest
        for k in range(j):
            hessian[k, j] = hessian[j, k]
    first = program.rows.shape[0] - count * horizon.bounded.shape[0]
    for r in range(horizon.bounded.shape[0]):
        for i in range(count):
            for j in range(i + 1):
                program.rows[first + r * count + i, j] = driven[i, horizon.bounded[r], j]


@cached_inner
def learn(hessian: Array, step: Array, change: Array) -> None:
    """Damped BFGS update (Nocedal & Wright 2006, procedure 18.2): Gauss-Newton has no curvature of what stays off."""
    count = step.shape[0]
    product = np.empty(count)
    curved = secant = 0.0
    for j in range(count):
        total = 0.0
        for k in range(count):
            total += hessian[j, k] * step[k]
        product[j] = total
        curved += step[j] * total
        secant += step[j] * change[j]
    if not (curved > 0.0 and abs(secant) < STEEPEST * curved):
        return
    share = 1.0 if secant >= 0.2 * curved else 0.8 * curved / (curved - secant)
    secant = share * secant + (1.0 - share) * curved
    for j in range(count):
        new = share * change[j] + (1.0 - share) * product[j]
        for k in range(count):
            other = share * change[k] + (1.0 - share) * product[k]
            hessian[j, k] += new * other / secant - product[j] * product[k] / curved


@cached_inner
def evaluate(horizon: Horizon, program: Program, question: Question) -> tuple[float, float]:
    """Gradient and bounds of the program for a question; the cost of the trajectory and the sum of its gaps."""
    count, states = horizon.reached.shape
    weights, inputs, gradient = horizon.weights, horizon.inputs, program.gradient
    shifted = question.disturbance[0] - horizon.disturbance[0]
    gradient[:] = 0.0
    cost = gap = 0.0
    for a in range(states):
        gap += abs(question.state[a] - horizon.states[0, a])
    for i in range(count):
        error = horizon.states[i + 1, horizon.output] - question.reference[i]
        cost += weights[0, i] * error * error
        error += _off(horizon, question, shifted, i, horizon.output)
        slope = 2.0 * weights[0, i] * error
        for j in range(i + 1):
            gradient[j] += slope * horizon.driven[i, horizon.output, j]
        for a in range(states):
            gap += abs(horizon.reached[i, a] - horizon.states[i + 1, a])
    for j in range(count):
        change = inputs[j] - (inputs[j - 1] if j > 0 else question.previous[0])
        cost += weights[1, j] * change * change + weights[2, j] * inputs[j] * inputs[j]
        gradient[j] += 2.0 * (weights[1, j] * change + weights[2, j] * inputs[j])
        if j > 0:
            gradient[j - 1] -= 2.0 * weights[1, j] * change
        program.lower[j] = -horizon.input_limit - inputs[j]
        program.upper[j] = horizon.input_limit - inputs[j]
        if np.isfinite(horizon.rate_limit):
            program.lower[count + j] = -horizon.rate_limit - change
            program.upper[count + j] = horizon.rate_limit - change
    first = program.lower.shape[0] - count * horizon.bounded.shape[0]
    for r in range(horizon.bounded.shape[0]):
        a = horizon.bounded[r]
        for i in range(count):
            outside = max(horizon.states[i + 1, a] - horizon.upper[a], horizon.lower[a] - horizon.states[i + 1, a], 0.0)
            cost += (horizon.price[0] + horizon.price[1] * outside) * outside
            expected = horizon.states[i + 1, a] + _off(horizon, question, shifted, i, a)
            program.lower[first + r * count + i] = max(horizon.lower[a] - expected, -1e30)
            program.upper[first + r * count + i] = min(horizon.upper[a] - expected, 1e30)
    return cost, gap


@cached_inner
def _off(horizon: Horizon, question: Question, shifted: float, i: int, a: int) -> float:
    """How far a state will be off the trajectory if the inputs stay."""
    total = horizon.forced[i, a]
    for b in range(horizon.free.shape[2]):
        total += horizon.free[i, a, b] * (question.state[b] - horizon.states[0, b])
    if shifted != 0.0:
        for j in range(i + 1):
            total += horizon.driven[i, a, j] * shifted
    return total


@cached_inner
def residual(horizon: Horizon, program: Program, question: Question) -> float:
    """KKT residual of the trajectory with the last multipliers."""
    count, states = horizon.reached.shape
    largest = 0.0
    for a in range(states):
        largest = max(largest, abs(question.state[a] - horizon.states[0, a]))
        for i in range(count):
            largest = max(largest, abs(horizon.reached[i, a] - horizon.states[i + 1, a]))
    for j in range(count):
        total = program.gradient[j] + program.multipliers[j]
        for r in range(program.rows.shape[0]):
            total += program.rows[r, j] * program.multipliers[count + r]
        largest = max(largest, abs(total))
    return largest


@cached_inner
def steepest(horizon: Horizon, question: Question) -> float:
    """The largest multiplier of a gap: how fast the cost can fall by opening one."""
    count, states = horizon.reached.shape
    adjoint, before = np.zeros(states), np.zeros(states)
    largest = 0.0
    for i in range(count - 1, -1, -1):
        error = horizon.states[i + 1, horizon.output] - question.reference[i]
        adjoint[horizon.output] += 2.0 * horizon.weights[0, i] * error
        for a in range(states):
            largest = max(largest, abs(adjoint[a]))
        for b in range(states):
            total = 0.0
            for a in range(states):
                total += horizon.A[i, a, b] * adjoint[a]
            before[b] = total
        assign(adjoint, before)
    return largest


@cached_inner
def expand(horizon: Horizon, program: Program, question: Question) -> None:
    """The step of inputs and states that a solution means."""
    count, states = horizon.reached.shape
    shifted = question.disturbance[0] - horizon.disturbance[0]
    assign(horizon.step, program.solution)
    for a in range(states):
        horizon.moved[0, a] = question.state[a] - horizon.states[0, a]
    for i in range(count):
        for a in range(states):
            total = horizon.reached[i, a] - horizon.states[i + 1, a]
            total += horizon.B[i, a, 0] * (horizon.step[i] + shifted)
            for b in range(states):
                total += horizon.A[i, a, b] * horizon.moved[i, b]
            horizon.moved[i + 1, a] = total


@cached_inner
def move(horizon: Horizon, length: float) -> None:
    """Go along the step."""
    for i in range(horizon.inputs.shape[0]):
        horizon.inputs[i] += length * horizon.step[i]
    for i in range(horizon.states.shape[0]):
        for a in range(horizon.states.shape[1]):
            horizon.states[i, a] += length * horizon.moved[i, a]


@numba.njit(**OPTIONS)
def respond(horizon: Horizon, program: Program, question: Question) -> bool:
    """The feedback of a real-time iteration: the step from what was prepared, its matrices factorised;
    and to it.

    False where the program has no solution; the trajectory then stays.
    """
    evaluate(horizon, program, question)
    if not quadratic.solve(program, GRADIENT | BOUNDS | STATES):
        return False
    quadratic.remember(program)
    expand(horizon, program, question)
    move(horizon, 1.0)
    assign(horizon.disturbance, question.disturbance)
    return True


@numba.njit("boolean(float64[::1])", cache=True, **OPTIONS)
def finite(values: Array) -> bool:
    """Whether all are numbers."""
    return bool(np.isfinite(values).all())
