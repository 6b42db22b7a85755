"""Multiple shooting in compiled code: a trajectory, the problem linearised about it, and the step to its solution.

Condensing: Bock & Plitt (1984), IFAC World Congress; Gauss-Newton real-time iteration: Diehl et al. (2002), J. Process
Control 12(4); Gros et al. (2020), Int. J. Control 93(1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import quadratic_program as quadratic
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program, QuadraticProgram
from hybrid_sysid_ros.equations import Equation, kernels
from hybrid_sysid_ros.equations.linearisation import linearisation, workspace
from hybrid_sysid_ros.errors import UserError

Array = NDArray[np.float64]

LEAST_CURVATURE = 1e-9
"""Added to the Hessian's diagonal, in shares of its largest entry: inputs without weight must not make it singular."""

STEP_HALVINGS = 4
"""Times that a step may be halved in search of a lower merit."""

MEMORY = 3
"""Steps among which the highest merit is the one to get below: a few that rise are how fast convergence looks."""


SLOW = 0.2
"""Share of the residual that a good Gauss-Newton step leaves at most; from slower steps the Hessian learns."""

STEEPEST = 1000.0
"""Curvature, in that of the Hessian, that no step may teach: it comes from corners, not from curves."""

SECANTS = 12
"""Steps of one solution that the Hessian learns from."""


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


class Prediction(NamedTuple):
    """The model as compiled functions take it: parameters (named), network (weights,), step [s] and substeps of an
    interval.
    """

    parameters: Any
    network: Array
    step: float
    substeps: int


class Answer(NamedTuple):
    """solved: the KKT residual is within the tolerance. iterations: programs solved; 0 where none had a solution.
    residual: largest of the gradient of the Lagrangian, the gaps and the initial gap.
    """

    solved: bool
    iterations: int
    residual: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Shooting:
    """The memory of one horizon and its compiled functions, which take it as their first arguments.

    prepare(model, horizon, program): linearise and condense about the trajectory.
    solve(model, horizon, program, question, iterations, tolerance, anew): prepare and step until solved; an
    :class:`Answer`. anew: forget what the Hessian learnt about the question before.
    begin(model, horizon, question): the input before, held, from the question's state.
    shift(model, horizon, fraction): the trajectory that much of an interval later.
    """

    model: Prediction
    horizon: Horizon
    program: Program
    memory: QuadraticProgram
    prepare: Callable[..., None]
    solve: Callable[..., Answer]
    begin: Callable[..., None]
    shift: Callable[..., None]


def shooting(equation: Equation, problem: Problem) -> Shooting:
    """Make the memory and the functions; those are compiled once for each form of equation (some seconds).

    Raises UserError for equations of several inputs, and bounds that are not as many as the states.
    """
    if len(equation.inputs) != 1:
        raise UserError(f"{type(equation).__name__}: the MPC takes models of one input")
    count, states = problem.horizon, len(equation.states)
    lower, upper = problem.bounds(states)
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    changes = count if np.isfinite(problem.rate_limit) else 0
    soft = np.arange(changes + count * len(bounded)) >= changes
    price = (problem.soft_linear / problem.output_scale, problem.soft_quadratic / problem.output_scale**2)
    memory = quadratic.quadratic_program(count, len(soft), soft_rows=soft, soft_weight=price)
    memory.program.rows[:changes] = np.eye(count)[:changes] - np.eye(count, k=-1)[:changes]
    horizon = Horizon(
        states=np.zeros((count + 1, states)),
        inputs=np.zeros(count),
        disturbance=np.zeros(1),
        A=np.zeros((count, states, states)),
        B=np.zeros((count, states, 1)),
        reached=np.zeros((count, states)),
        free=np.zeros((count, states, states)),
        driven=np.zeros((count, states, count)),
        forced=np.zeros((count, states)),
        output=equation.outputs[0],
        weights=problem.weights,
        input_limit=problem.input_limit,
        rate_limit=problem.rate_limit,
        bounded=bounded,
        lower=lower,
        upper=upper,
        price=np.array(price),
        step=np.zeros(count),
        moved=np.zeros((count + 1, states)),
        secants=np.zeros((2, SECANTS, count)),
        learnt=np.zeros(1, np.int64),
        rows=workspace(equation),
    )
    model = Prediction(
        parameters=equation.named,
        network=equation.weights,
        step=problem.period / problem.substeps,
        substeps=problem.substeps,
    )
    functions = _compiled(equation, problem.smoothing)
    return Shooting(model=model, horizon=horizon, program=memory.program, memory=memory, **functions)


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "fastmath": {"contract"}}
_COMPILED: dict[tuple[Any, ...], dict[str, Any]] = {}


def _compiled(equation: Equation, smoothing: float) -> dict[str, Any]:
    """The functions that depend on the equation."""
    key = (*equation.form, smoothing)
    if key in _COMPILED:
        return _COMPILED[key]
    linearise = linearisation(equation, smoothing=smoothing)
    advance = kernels(equation).step

    def interval(model: Any, horizon: Any, i: int, drive: Array, x: Array, following: Array) -> None:
        """Where the exact form goes from state i with input i in one interval."""
        drive[0] = horizon.inputs[min(i, horizon.inputs.shape[0] - 1)] + horizon.disturbance[0]
        for a in range(x.shape[0]):
            x[a] = horizon.states[i, a]
        for _ in range(model.substeps):
            advance(x, drive, model.parameters, model.network, model.step, following)
            for a in range(x.shape[0]):
                x[a] = following[a]

    interval = numba.njit(interval, **_OPTIONS)

    def prepare(model: Any, horizon: Any, program: Any) -> None:
        drive = np.empty(1)
        for i in range(horizon.inputs.shape[0]):
            drive[0] = horizon.inputs[i] + horizon.disturbance[0]
            linearise(
                horizon.states[i],
                drive,
                model.parameters,
                model.network,
                model.step,
                model.substeps,
                horizon.rows,
                horizon.reached[i],
                horizon.A[i],
                horizon.B[i],
            )
        _condense(horizon, program)

    def begin(model: Any, horizon: Any, question: Any) -> None:
        count, states, limit = horizon.inputs.shape[0], question.state.shape[0], horizon.input_limit
        drive, x, following = np.empty(1), np.empty(states), np.empty(states)
        horizon.disturbance[0] = question.disturbance[0]
        for a in range(states):
            horizon.states[0, a] = question.state[a]
        for i in range(count):
            horizon.inputs[i] = min(max(question.previous[0], -limit), limit)
            interval(model, horizon, i, drive, x, following)
            for a in range(states):
                horizon.states[i + 1, a] = x[a]

    def shift(model: Any, horizon: Any, fraction: float) -> None:
        count, states = horizon.reached.shape
        drive, x, following = np.empty(1), np.empty(states), np.empty(states)
        interval(model, horizon, count, drive, x, following)
        for i in range(count):
            following_input = horizon.inputs[min(i + 1, count - 1)]
            horizon.inputs[i] = (1.0 - fraction) * horizon.inputs[i] + fraction * following_input
            for a in range(states):
                horizon.states[i, a] = (1.0 - fraction) * horizon.states[i, a] + fraction * horizon.states[i + 1, a]
        for a in range(states):
            horizon.states[count, a] = (1.0 - fraction) * horizon.states[count, a] + fraction * x[a]

    prepare = numba.njit(prepare, **_OPTIONS)

    def solve(
        model: Any, horizon: Any, program: Any, question: Any, iterations: int, tolerance: float, anew: bool
    ) -> Answer:
        """Full steps, halved where the merit rises above that of the last few (Grippo et al. 1986)."""
        before = np.zeros(horizon.inputs.shape[0])
        horizon.states[0] = question.state
        horizon.disturbance[:] = question.disturbance
        merits = np.full(MEMORY, np.inf)
        penalty, residual, last, length, halvings, done = 0.0, np.inf, np.inf, 0.0, 0, 0
        learnt = 0 if anew else horizon.learnt[0]
        while True:
            prepare(model, horizon, program)
            cost, gap = _evaluate(horizon, program, question)
            residual = _residual(horizon, program, question)
            if done > 0 and residual <= tolerance:
                return Answer(True, done, residual)
            penalty = max(penalty, 2.0 * _steepest(horizon, question))
            merit = cost + penalty * gap
            if done > 0 and halvings < STEP_HALVINGS and not merit <= np.max(merits) + 1e-9 * abs(merit):
                halvings += 1
                length *= 0.5
                _move(horizon, -length)
                continue
            if done == iterations:
                return Answer(False, done, residual)
            if done > 1 and residual > SLOW * last:
                steps, changes = horizon.secants
                for j in range(before.shape[0]):
                    steps[learnt % SECANTS, j] = length * horizon.step[j]
                    changes[learnt % SECANTS, j] = program.gradient[j] - before[j]
                learnt += 1
                horizon.learnt[0] = learnt
            for k in range(max(learnt - SECANTS, 0), learnt):
                _learn(program.hessian, horizon.secants[0, k % SECANTS], horizon.secants[1, k % SECANTS])
            before[:] = program.gradient
            last = residual
            if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
                if learnt == 0:
                    return Answer(False, 0, residual)
                learnt = 0
                continue
            quadratic.remember(program)
            merits[done % MEMORY] = merit
            done += 1
            _expand(horizon, program, question)
            length, halvings = 1.0, 0
            _move(horizon, 1.0)

    _COMPILED[key] = {
        "prepare": prepare,
        "begin": numba.njit(begin, **_OPTIONS),
        "shift": numba.njit(shift, **_OPTIONS),
        "solve": numba.njit(solve, **_OPTIONS),
    }
    return _COMPILED[key]


@numba.njit(cache=True, **_OPTIONS)
def _condense(horizon: Horizon, program: Program) -> None:
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
            program.rows[first + r * count + i, : i + 1] = driven[i, horizon.bounded[r], : i + 1]


@numba.njit(cache=True, **_OPTIONS)
def _learn(hessian: Array, step: Array, change: Array) -> None:
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


@numba.njit(cache=True, **_OPTIONS)
def _evaluate(horizon: Horizon, program: Program, question: Question) -> tuple[float, float]:
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


@numba.njit(cache=True, **_OPTIONS)
def _off(horizon: Horizon, question: Question, shifted: float, i: int, a: int) -> float:
    """How far a state will be off the trajectory if the inputs stay."""
    total = horizon.forced[i, a]
    for b in range(horizon.free.shape[2]):
        total += horizon.free[i, a, b] * (question.state[b] - horizon.states[0, b])
    if shifted != 0.0:
        for j in range(i + 1):
            total += horizon.driven[i, a, j] * shifted
    return total


@numba.njit(cache=True, **_OPTIONS)
def _residual(horizon: Horizon, program: Program, question: Question) -> float:
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


@numba.njit(cache=True, **_OPTIONS)
def _steepest(horizon: Horizon, question: Question) -> float:
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
        adjoint[:] = before
    return largest


@numba.njit(cache=True, **_OPTIONS)
def _expand(horizon: Horizon, program: Program, question: Question) -> None:
    """The step of inputs and states that a solution means."""
    count, states = horizon.reached.shape
    shifted = question.disturbance[0] - horizon.disturbance[0]
    horizon.step[:] = program.solution
    for a in range(states):
        horizon.moved[0, a] = question.state[a] - horizon.states[0, a]
    for i in range(count):
        for a in range(states):
            total = horizon.reached[i, a] - horizon.states[i + 1, a]
            total += horizon.B[i, a, 0] * (horizon.step[i] + shifted)
            for b in range(states):
                total += horizon.A[i, a, b] * horizon.moved[i, b]
            horizon.moved[i + 1, a] = total


@numba.njit(cache=True, **_OPTIONS)
def _move(horizon: Horizon, length: float) -> None:
    """Go along the step."""
    for i in range(horizon.inputs.shape[0]):
        horizon.inputs[i] += length * horizon.step[i]
    for i in range(horizon.states.shape[0]):
        for a in range(horizon.states.shape[1]):
            horizon.states[i, a] += length * horizon.moved[i, a]


@numba.njit(**_OPTIONS)
def respond(horizon: Horizon, program: Program, question: Question) -> bool:
    """The feedback of a real-time iteration: the step for a question from what was prepared, and to it.

    False where the program has no solution; the trajectory then stays.
    """
    _evaluate(horizon, program, question)
    if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
        return False
    quadratic.remember(program)
    _expand(horizon, program, question)
    _move(horizon, 1.0)
    horizon.disturbance[:] = question.disturbance
    return True
