"""The exact MPC in compiled code: its memory, its trajectories, both phases of a real-time iteration, and a call.

Real-time iteration around a trajectory with gaps: Bock & Plitt (1984), IFAC World Congress; Diehl et al. (2002), J.
Process Control 12(4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.condensing import apply_step, condense, evaluate_program
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel, new_horizon, prediction
from hybrid_sysid_ros.control.mpc.limits import clamp_inputs
from hybrid_sysid_ros.control.mpc.linearisation import (
    advance_interval,
    assign,
    assign_rows,
    follow,
    linearise,
)
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, STATES, Program
from hybrid_sysid_ros.control.mpc.sequential import SolverResult, foreseen, improve, make_step, simulated_cost, solve
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.stage_cost import StageWeights
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.arrays import Array

CONVERGE, FEEDBACK, IMPROVE, UNCHECKED = range(4)
"""How a call is answered: by steps until convergence, by the feedback phase of the prepared program, by one step around
the trajectory from the state itself, for which nothing is prepared, or by a feedback phase whose plan is not simulated.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonMemory:
    """The memory of one horizon, for the compiled functions here."""

    prediction: PredictionModel
    horizon: Horizon
    program: Program
    memory: tuple[Any, ...]
    """Memory of the program."""


def shooting(system: System, problem: ControlProblem) -> HorizonMemory:
    """The memory of a problem.

    Raises UserError for a problem with other numbers of inputs, outputs or states.
    """
    problem = problem.sized(system)
    horizon, m = new_horizon(system, problem), len(system.inputs)
    weights, limits = horizon.weights, horizon.limits
    rated = len(limits.rated)
    soft = np.concatenate([np.zeros(rated, bool), np.ones(len(limits.bounded), bool), ~limits.hard])
    linear = [np.zeros(rated), weights.linear[limits.bounded], weights.value_linear[limits.values]]
    squares = [np.ones(rated), weights.quadratic[limits.bounded], weights.value_quadratic[limits.values]]
    rows = np.concatenate([limits.rate_rows, limits.state_rows, limits.value_rows])
    of_row = np.nonzero(rows >= 0)[0]
    program, memory = quadratic.quadratic_program(
        int(limits.moves[-1] + 1) * m,
        len(of_row),
        soft_rows=soft[of_row],
        soft_linear=np.concatenate(linear)[of_row],
        soft_quadratic=np.concatenate(squares)[of_row],
    )
    for j, of in zip(limits.rated, limits.rate_rows, strict=True):
        for block, row in enumerate(of[of >= 0]):
            program.rows[row, block * m + j] = 1.0
            if block > 0:
                program.rows[row, (block - 1) * m + j] = -1.0
    return HorizonMemory(prediction=prediction(system, problem), horizon=horizon, program=program, memory=memory)


# ---------------------------------------------------------------------- trajectories


@inner
def cold_start(horizon: Horizon, instance: Instance) -> None:
    """The previous inputs, held; the solver finds their states."""
    assign(horizon.disturbance, instance.disturbance)
    for i in range(horizon.inputs.shape[0]):
        for j in range(horizon.inputs.shape[1]):
            horizon.inputs[i, j] = min(max(instance.previous[j], horizon.limits.low[j]), horizon.limits.high[j])


@inner
def shift_trajectory(prediction: PredictionModel, horizon: Horizon, fraction: float) -> None:
    """Shift the trajectory by a fraction of an interval."""
    count, n = horizon.linear.reached.shape
    m = horizon.inputs.shape[1]
    drive, x, following = np.empty(m), np.empty(n), np.empty(n)
    assign(x, horizon.states[count])
    for j in range(m):
        drive[j] = horizon.inputs[count - 1, j] + horizon.disturbance[j]
    advance_interval(prediction, x, drive, following)
    for i in range(count + 1):
        for a in range(n):
            after = x[a] if i == count else horizon.states[i + 1, a]
            horizon.states[i, a] = (1.0 - fraction) * horizon.states[i, a] + fraction * after
        if i < count - 1:
            for j in range(m):
                horizon.inputs[i, j] = (1.0 - fraction) * horizon.inputs[i, j] + fraction * horizon.inputs[i + 1, j]


@kernel
def rollout(
    prediction: PredictionModel, weights: StageWeights, instance: Instance, inputs: Array, states: Array
) -> tuple[float, float]:
    """:func:`follow` for Python."""
    return follow(prediction, weights, instance, inputs, states)  # type: ignore[no-any-return]


@kernel
def bound_inputs(horizon: Horizon, previous: Array, inputs: Array) -> None:
    """Limit inputs (N, m) to their bounds and rate limits after ``previous`` (m,)."""
    clamp_inputs(horizon, previous, inputs, False)


# ---------------------------------------------------------------------- the two phases of a real-time iteration


@inner
def linearise_program(prediction: PredictionModel, horizon: Horizon, program: Program) -> None:
    """The preparation phase: linearise around the trajectory and condense."""
    for i in range(1, horizon.inputs.shape[0]):
        if horizon.limits.moves[i] == horizon.limits.moves[i - 1]:
            assign(horizon.inputs[i], horizon.inputs[i - 1])
    linearise(prediction, horizon, prediction.smoothing, False)
    condense(horizon, program)


@inner
def iterate(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, way: int
) -> SolverResult:
    """A real-time step: the feedback phase, which is the step from the prepared program, whose matrices are factorised,
    or by the way IMPROVE one around the state itself. By the way UNCHECKED states keep the gaps that the step leaves.

    Where the plan of a feedback phase costs more than predicted, the state differs from the prepared one, and the step
    is made around the state itself, too. A result with 0 iterations means that the program has no solution; the
    trajectory then stays.
    """
    if way != IMPROVE:
        evaluate_program(horizon, program, instance, True)
        if not quadratic.solve(program, GRADIENT | BOUNDS | STATES):
            return SolverResult(False, 0, np.inf)
        quadratic.keep_working_set(program)
        expected, change = make_step(prediction, horizon, program, instance)
        if way == UNCHECKED or foreseen(horizon, expected, change, simulated_cost(prediction, horizon, instance)):
            return SolverResult(False, 1, np.inf)
        apply_step(horizon, -1.0)
    return improve(prediction, horizon, program, instance, way == IMPROVE)


# ---------------------------------------------------------------------- a call of the controller


@inner
def answer(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    instance: Instance,
    iterations: int,
    tolerance: float,
    cold: bool,
    way: int,
    anew: bool,
) -> SolverResult:
    """A call of the controller. way: CONVERGE, FEEDBACK or IMPROVE. anew: False makes further steps for the last call.

    The plan is in ``horizon.planned``. With 0 iterations the trajectory has not changed.
    """
    if anew and not _begin(horizon, instance, cold):
        return SolverResult(False, 0, np.inf)
    if way == CONVERGE:
        found = solve(prediction, horizon, program, instance, iterations, tolerance, anew, cold)
    else:
        found = iterate(prediction, horizon, program, instance, way)
    sound = found.iterations > 0
    for i in range(horizon.inputs.shape[0]):
        sound = sound and _finite(horizon.inputs[i]) and _finite(horizon.states[i + 1])
    if not sound:
        restore_trajectory(horizon, program)
        return SolverResult(False, 0, found.residual)
    plan_within(horizon, instance)
    return found


@inner
def _begin(horizon: Horizon, instance: Instance, cold: bool) -> bool:
    """Prepare the initial trajectory of a call and keep it; False where part of the instance is not a number."""
    if not (_finite(instance.state) and _finite(instance.disturbance) and _finite(instance.previous)):
        return False
    for i in range(instance.preview.shape[0]):
        if not _finite(instance.preview[i]):
            return False
    for j in range(instance.previous.shape[0]):
        instance.previous[j] = min(max(instance.previous[j], horizon.limits.low[j]), horizon.limits.high[j])
    if cold:
        cold_start(horizon, instance)
    assign_rows(horizon.states, horizon.last.states)
    assign_rows(horizon.inputs, horizon.last.inputs)
    assign(horizon.last.disturbance, horizon.disturbance)
    return True


@inner
def plan_within(horizon: Horizon, instance: Instance) -> None:
    """Write the plan: inputs of the trajectory within all limits after the previous input."""
    assign_rows(horizon.inputs, horizon.planned)
    clamp_inputs(horizon, instance.previous, horizon.planned, False)


@inner
def restore_trajectory(horizon: Horizon, program: Program) -> None:
    """Restore the trajectory before a solution, and forget the multipliers that were found."""
    assign_rows(horizon.last.states, horizon.states)
    assign_rows(horizon.last.inputs, horizon.inputs)
    assign(horizon.disturbance, horizon.last.disturbance)
    quadratic.clear_working_set(program)


@inner
def _finite(values: Array) -> bool:
    """Whether all values are finite."""
    sound = True
    for i in range(values.shape[0]):
        sound = sound and math.isfinite(values[i])
    return sound
