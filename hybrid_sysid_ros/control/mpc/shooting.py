"""Shooting in compiled code: the problem of a model linearised about a trajectory, again and again.

Sequential quadratic programming on the inputs, the states being simulated at each iterate, and the two phases of a
real-time iteration about a trajectory with gaps: Bock & Plitt (1984), IFAC World Congress; Diehl et al. (2002), J.
Process Control 12(4); Tenny, Wright & Rawlings (2004), Computational Optimization and Applications 28 (feasible SQP).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.condensing import (
    condense,
    cost_of,
    cut,
    evaluate,
    expand,
    find_adjoint,
    move,
    residual,
)
from hybrid_sysid_ros.control.mpc.curvature import add_curvature, keep_derivatives, update_curvature
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, Prediction, new_horizon, prediction
from hybrid_sysid_ros.control.mpc.linearisation import advance, assign, find_curvature, linearise
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program, QuadraticProgram
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.stage_cost import StageWeights, excess, stage_cost
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

HALVINGS = 8
"""Times that a step may be halved in search of a cost that is no higher."""

SLOW = 0.1
"""Share of the residual that a good Gauss-Newton step leaves at most; after a slower one the curvature of the dynamics
is taken in.
"""

STALLED, PATIENCE = 0.5, 3
"""Share of the residual from which on a step with curvature was a bad one, and steps before that counts."""

DOUBT = 0.05
"""Share by which a plan of a feedback phase may cost more than was predicted."""

COARSE = 30.0
"""By how much wider stick-slip is rounded for a second try at a first step that led uphill: where everything sticks,
the derivatives by the inputs say next to nothing.
"""


class SolverResult(NamedTuple):
    """What :func:`solve` found."""

    solved: bool
    """The KKT residual is within the tolerance."""
    iterations: int
    """Steps made; 0 where a quadratic program had no solution."""
    residual: float
    """The largest entry of the gradient of the Lagrangian."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shooting:
    """The memory of one horizon: what the compiled functions here take."""

    prediction: Prediction
    horizon: Horizon
    program: Program
    memory: QuadraticProgram


def shooting(system: System, problem: Problem) -> Shooting:
    """Make the memory.

    Raises UserError for a problem of other numbers of inputs, outputs or states, and for inputs of different delays.
    """
    problem = problem.sized(system)
    one_delay(system, problem)
    horizon, count, m = new_horizon(system, problem), problem.horizon, len(system.inputs)
    hard, soft = count * len(horizon.rated), count * len(horizon.bounded)
    memory = quadratic.quadratic_program(
        count * m,
        hard + soft,
        soft_rows=np.arange(hard + soft) >= hard,
        soft_linear=np.concatenate([np.zeros(hard), np.repeat(horizon.weights.linear[horizon.bounded], count)]),
        soft_quadratic=np.concatenate([np.ones(hard), np.repeat(horizon.weights.quadratic[horizon.bounded], count)]),
    )
    for r, j in enumerate(horizon.rated):
        for i in range(count):
            memory.program.rows[r * count + i, i * m + j] = 1.0
            if i > 0:
                memory.program.rows[r * count + i, (i - 1) * m + j] = -1.0
    return Shooting(prediction=prediction(system, problem), horizon=horizon, program=memory.program, memory=memory)


def one_delay(system: System, problem: Problem) -> None:
    """Raise UserError for inputs whose delays differ by more than half an integration step: a controller is given the
    state that all its inputs will meet.
    """
    delays = system.input_delays
    if np.ptp(delays) > 0.5 * problem.period / problem.substeps:
        raise UserError(
            f"{type(system).__name__}: its inputs have different delays, {delays.tolist()} s; the MPC needs one for "
            "all: delay the faster inputs as much"
        )


# ---------------------------------------------------------------------- trajectories


@kernel
def cold_start(prediction: Prediction, horizon: Horizon, instance: Instance) -> None:
    """The trajectory of the inputs before, held."""
    count, m = horizon.inputs.shape
    drive, x, following = np.empty(m), instance.state.copy(), np.empty(instance.state.shape[0])
    assign(horizon.disturbance, instance.disturbance)
    assign(horizon.states[0], x)
    for i in range(count):
        for j in range(m):
            horizon.inputs[i, j] = min(max(instance.previous[j], horizon.low[j]), horizon.high[j])
            drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]
        advance(prediction, x, drive, following)
        assign(horizon.states[i + 1], x)


@kernel
def shift(prediction: Prediction, horizon: Horizon, fraction: float) -> None:
    """The trajectory that much of an interval later."""
    count, n = horizon.reached.shape
    m = horizon.inputs.shape[1]
    drive, x, following = np.empty(m), horizon.states[count].copy(), np.empty(n)
    for j in range(m):
        drive[j] = horizon.inputs[count - 1, j] + horizon.disturbance[j]
    advance(prediction, x, drive, following)
    for i in range(count + 1):
        for a in range(n):
            after = x[a] if i == count else horizon.states[i + 1, a]
            horizon.states[i, a] = (1.0 - fraction) * horizon.states[i, a] + fraction * after
        if i < count - 1:
            for j in range(m):
                horizon.inputs[i, j] = (1.0 - fraction) * horizon.inputs[i, j] + fraction * horizon.inputs[i + 1, j]


@kernel
def rollout(
    prediction: Prediction, weights: StageWeights, instance: Instance, inputs: Array, states: Array
) -> tuple[float, float]:
    """Simulate inputs (N, m) in the exact form into ``states`` (N + 1, n); their cost, and by how much a state is
    outside of its bounds at most.
    """
    n, m = instance.state.shape[0], inputs.shape[1]
    drive, x, following = np.empty(m), instance.state.copy(), np.empty(n)
    y = np.empty(instance.preview.shape[1])
    cost = largest = 0.0
    assign(states[0], x)
    for i in range(inputs.shape[0]):
        for j in range(m):
            drive[j] = inputs[i, j] + instance.disturbance[j]
        advance(prediction, x, drive, following)
        call_value(prediction.output, x, drive, prediction.parameters, prediction.network, prediction.h, 0.0, y)
        assign(states[i + 1], x)
        before = instance.previous if i == 0 else inputs[i - 1]
        cost += stage_cost(weights, i, y, instance.preview[i], inputs[i], before, x)
        for a in range(n):
            largest = max(largest, excess(weights, a, x[a]))
    return cost, largest


@kernel
def bounded(horizon: Horizon, previous: Array, inputs: Array) -> None:
    """Cut inputs (N, m) to their bounds and rate limits after ``previous`` (m,)."""
    cut(horizon, previous, inputs)


@kernel
def forget(program: Program) -> None:
    """Begin the next search anew: at no constraint."""
    quadratic.clear_working_set(program)


# ---------------------------------------------------------------------- sequential quadratic programming


@kernel
def solve(
    prediction: Prediction,
    horizon: Horizon,
    program: Program,
    instance: Instance,
    iterations: int,
    tolerance: float,
    anew: bool,
) -> SolverResult:
    """Step until solved: by Gauss-Newton, and where that is slow by Newton's method. anew: else go on from the call
    before.
    """
    assign(horizon.states[0], instance.state)
    assign(horizon.disturbance, instance.disturbance)
    cut(horizon, instance.previous, horizon.inputs)
    if anew:
        horizon.progress[:] = 0.0
    linearise(prediction, horizon, prediction.smoothing, True)
    cost, last, done = cost_of(horizon, instance), horizon.progress[1], 0
    while True:
        condense(horizon, program)
        evaluate(horizon, program, instance, False)
        error, made = residual(program), horizon.progress[0]
        if made > 0 and error <= tolerance:
            return SolverResult(True, done, error)
        if done == iterations:
            horizon.progress[1] = last
            return SolverResult(False, done, error)
        _find_hessian(prediction, horizon, program, instance, error, last)
        if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
            return SolverResult(False, 0, error)
        quadratic.keep_working_set(program)
        cost = _search(prediction, horizon, program, instance, cost, made == 0)
        last = error
        horizon.progress[0] += 1
        done += 1


@inner
def _find_hessian(
    prediction: Prediction, horizon: Horizon, program: Program, instance: Instance, error: float, last: float
) -> None:
    """Add the curvature of the dynamics to the Hessian where Gauss-Newton is slow: as the steps tell it, and where that
    is slow too, by differences.
    """
    made = horizon.progress[0]
    if made == 0:
        horizon.curvature[:] = 0.0
    else:
        find_adjoint(horizon, program, instance)
        if horizon.progress[2] > 0.0 and made > PATIENCE and error > STALLED * last:
            find_curvature(prediction, horizon)
        else:
            update_curvature(horizon)
        if error > SLOW * last:
            horizon.progress[2] = 1.0
        if horizon.progress[2] > 0.0:
            add_curvature(horizon, program)
    keep_derivatives(horizon)


@inner
def _search(
    prediction: Prediction, horizon: Horizon, program: Program, instance: Instance, cost: float, first: bool
) -> float:
    """Make the step of a solution, halved until the cost is no higher; the new cost. The model is linearised there."""
    length = 1.0
    _step(horizon, program, 1.0)
    for halving in range(HALVINGS + 1):
        linearise(prediction, horizon, prediction.smoothing, True)
        found = cost_of(horizon, instance)
        if found <= cost + 1e-9 * abs(cost):
            break
        if halving < HALVINGS:
            length *= 0.5
            _step(horizon, program, -length)
        if first and halving == 1 and prediction.smoothing > 0.0:
            _step(horizon, program, -length)
            length = _coarse_step(prediction, horizon, program, instance)
    return found


@inner
def _coarse_step(prediction: Prediction, horizon: Horizon, program: Program, instance: Instance) -> float:
    """Make the step that rounder stick-slip proposes; its length, 0 where there is none."""
    linearise(prediction, horizon, COARSE * prediction.smoothing, True)
    condense(horizon, program)
    evaluate(horizon, program, instance, False)
    if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
        return 0.0
    quadratic.keep_working_set(program)
    _step(horizon, program, 1.0)
    return 1.0


@inner
def _step(horizon: Horizon, program: Program, length: float) -> None:
    """Move the inputs along a solution."""
    count, m = horizon.inputs.shape
    for i in range(count):
        for j in range(m):
            horizon.inputs[i, j] += length * program.solution[i * m + j]


# ---------------------------------------------------------------------- the two phases of a real-time iteration


@kernel
def prepare(prediction: Prediction, horizon: Horizon, program: Program) -> None:
    """The preparation phase: linearise and condense about the trajectory."""
    linearise(prediction, horizon, prediction.smoothing, False)
    condense(horizon, program)


@kernel
def feedback(
    prediction: Prediction, horizon: Horizon, program: Program, instance: Instance, tolerance: float
) -> SolverResult:
    """The feedback phase: the step from what was prepared, its matrices factorised.

    Where the plan costs more than was predicted the state is not the one that was prepared for, and the step is made
    about the state itself instead. A result of no iterations: the program has no solution; the trajectory then stays.
    """
    evaluate(horizon, program, instance, True)
    if not quadratic.solve(program, GRADIENT | BOUNDS | STATES):
        return SolverResult(False, 0, np.inf)
    quadratic.keep_working_set(program)
    expected = expand(horizon, program, instance)
    move(horizon, 1.0)
    found, _ = rollout(prediction, horizon.weights, instance, horizon.inputs, horizon.simulated)
    if found <= (1.0 + DOUBT) * expected:
        assign(horizon.disturbance, instance.disturbance)
        return SolverResult(False, 1, np.inf)
    move(horizon, -1.0)
    return solve(prediction, horizon, program, instance, 1, tolerance, True)


# ---------------------------------------------------------------------- a call of the controller


@kernel
def answer(
    prediction: Prediction,
    horizon: Horizon,
    program: Program,
    instance: Instance,
    iterations: int,
    tolerance: float,
    cold: bool,
    prepared: bool,
) -> SolverResult:
    """A call of the controller: the feedback phase where one is prepared, else as many steps as it takes.

    The plan is in ``horizon.planned``. A result of no iterations: the trajectory is what it was.
    """
    if not (_finite(instance.state) and _finite(instance.disturbance) and _finite(instance.previous)):
        return SolverResult(False, 0, np.inf)
    for i in range(instance.preview.shape[0]):
        if not _finite(instance.preview[i]):
            return SolverResult(False, 0, np.inf)
    for j in range(instance.previous.shape[0]):
        instance.previous[j] = min(max(instance.previous[j], horizon.low[j]), horizon.high[j])
    if cold:
        cold_start(prediction, horizon, instance)
    _copy(horizon.states, horizon.kept_states)
    _copy(horizon.inputs, horizon.kept_inputs)
    assign(horizon.kept_disturbance, horizon.disturbance)
    if prepared:
        found = feedback(prediction, horizon, program, instance, tolerance)
    else:
        found = solve(prediction, horizon, program, instance, iterations, tolerance, True)
    sound = found.iterations > 0
    for i in range(horizon.inputs.shape[0]):
        sound = sound and _finite(horizon.inputs[i]) and _finite(horizon.states[i + 1])
    if not sound:
        restore(horizon, program)
        return SolverResult(False, 0, found.residual)
    plan(horizon, instance)
    return found


@kernel
def plan(horizon: Horizon, instance: Instance) -> None:
    """The inputs of the trajectory, within all limits after the input before."""
    _copy(horizon.inputs, horizon.planned)
    cut(horizon, instance.previous, horizon.planned)


@kernel
def restore(horizon: Horizon, program: Program) -> None:
    """Take the trajectory back that was there before a solution, and forget what was found on the way."""
    _copy(horizon.kept_states, horizon.states)
    _copy(horizon.kept_inputs, horizon.inputs)
    assign(horizon.disturbance, horizon.kept_disturbance)
    quadratic.clear_working_set(program)


@inner
def _copy(values: Array, target: Array) -> None:
    for i in range(values.shape[0]):
        assign(target[i], values[i])


@inner
def _finite(values: Array) -> bool:
    """Whether all are numbers."""
    sound = True
    for i in range(values.shape[0]):
        sound = sound and bool(np.isfinite(values[i]))
    return sound
