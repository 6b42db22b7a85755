"""A loop of a trial as one kernel: the exact MPC, the network or the supervisor drives, and the exact MPC judges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.calls import (
    FAILED,
    HELD,
    POLICY,
    SOLVED,
    MpcMemory,
    adopt_plan,
    forget_plan,
    hold,
    shift_plan,
)
from hybrid_sysid_ros.control.mpc.horizon import Instance, PredictionModel, instance_of
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, follow
from hybrid_sysid_ros.control.policy.kernels import network_answer
from hybrid_sysid_ros.control.problem import StageWeights
from hybrid_sysid_ros.control.safety.supervision import (
    SupervisorMemory,
    answer_supervised,
    begin_supervision,
    prepare_supervised,
)
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.extensions.policies.criteria import EXACT, NETWORK, SUPERVISED
from hybrid_sysid_ros.extensions.policies.solved_instances import SolvedInstances, solve_once
from hybrid_sysid_ros.extensions.shared.loop_kernels import LoopArrays, advance_plant, ask_controller
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialLoop(Shared):
    """A loop of T periods: who drives it, its course, and what was said in it; n states, m inputs, p outputs."""

    beside: MpcMemory
    """The judge."""
    supervision: SupervisorMemory
    solved: SolvedInstances
    plant: PredictionModel
    weights: StageWeights
    """Of one stage."""
    course: LoopArrays
    asked: Array
    """(n + 2 m + N p,), what the drivers are asked."""
    stage: Array
    """(n + 2 m + p,)."""
    input_error: Array
    """(m,), see :class:`~.criteria.Criteria`."""
    inputs: Array
    """(N, m), the driver's plan."""
    first: Array
    """(N, m), the judge's."""
    kept_inputs: Array
    """(N, m), the judge's trajectory."""
    kept_states: Array
    """(N + 1, n)."""
    own_inputs: Array
    """(T, N, m), trajectories of the exact MPC's own loop; NaN in periods without."""
    own_states: Array
    """(T, N + 1, n)."""
    own_constraints: NDArray[np.int32]
    """(T, constraints), their working sets."""
    exact: Array
    """(T, m), answers of the judge."""
    answered: NDArray[np.bool_]
    """(T,), whether there is such an answer."""
    solutions: NDArray[np.bool_]
    """(T,), whether it is converged."""
    reasons: NDArray[np.int64]
    """(T,), of the online check; -1 where none was made."""
    outputs: Array
    """(T, p), at the end of each period."""


@kernel
def drive(loop: TrialLoop, driver: int, interval: float) -> None:
    """Run the loop of a driver; interval: its period [s].

    Beside the network the judge begins at the exact MPC's own plan of the same period, where that loop came first:
    errors and pushes are the same there, so it is nearer than the judge's last plan.
    """
    beside, own, solved, course = loop.beside, loop.supervision, loop.solved, loop.course
    (n, m), p = loop.kept_states.shape[1:] + loop.first.shape[1:], loop.outputs.shape[1]
    asked = instance_of(loop.asked, n, m, p)
    mine = instance_of(own.flat, n, m, p)
    stage = instance_of(loop.stage, n, m, p)
    if driver == EXACT:
        solved.count[0] = 0
    if driver == SUPERVISED:
        begin_supervision(own)
    forget_plan(beside)
    course.excess[0] = 0.0
    for k in range(loop.exact.shape[0]):
        ask_controller(beside.horizon, stage, course, k == 0, k, loop.asked)
        if driver == NETWORK and math.isfinite(loop.own_inputs[k, 0, 0]):
            adopt_plan(beside, asked.disturbance, loop.own_inputs[k], loop.own_states[k])
            assign(beside.program.states, loop.own_constraints[k])
        solve_once(beside, asked, solved)
        status = first = beside.call[0].status
        if driver == EXACT:
            assign_rows(beside.horizon.inputs, loop.own_inputs[k])
            assign_rows(beside.horizon.states, loop.own_states[k])
            assign(loop.own_constraints[k], beside.program.states)
            if first == FAILED:
                loop.own_inputs[k, 0, 0] = math.nan
        assign_rows(beside.horizon.planned, loop.first)
        assign_rows(loop.first, loop.inputs)
        assign(loop.exact[k], loop.first[0])
        loop.reasons[k] = -1
        if driver == NETWORK:
            status = POLICY
            if not network_answer(own.sizes, own.numbers, loop.asked, loop.inputs):
                status = HELD
                hold(beside.horizon, asked)
                assign_rows(beside.horizon.planned, loop.inputs)
        elif driver == SUPERVISED:
            assign(own.flat, loop.asked)
            answer_supervised(own, mine, solve_once, solved)
            status = own.mpc.call[0].status
            assign_rows(own.mpc.horizon.planned, loop.inputs)
            prepare_supervised(own, mine, interval, solve_once, solved)
            loop.reasons[k] = own.course[0].reason
        loop.answered[k], loop.solutions[k] = first != FAILED, first == SOLVED
        doubted = driver != EXACT and status != HELD and not (first != FAILED and _agreed(loop))
        if doubted and _solve_from_driver(loop, asked):
            loop.answered[k] = True
            assign(loop.exact[k], beside.horizon.planned[0])
        shift_plan(beside)
        advance_plant(loop.plant, loop.weights, stage, loop.inputs, course, k)
        _show(loop, k)


@inner
def _agreed(loop: TrialLoop) -> bool:
    """Whether driver and judge agree within the error that is allowed."""
    near = True
    for j in range(loop.input_error.shape[0]):
        near = near and abs(loop.inputs[0, j] - loop.first[0, j]) <= loop.input_error[j]
    return near


@inner
def _solve_from_driver(loop: TrialLoop, asked: Instance) -> bool:
    """Let the judge begin at the driver's plan; False where the solution that it then finds costs more than its own, to
    which it returns. Its problem may have several local solutions, of which the cheaper one is the answer.
    """
    mpc, horizon = loop.beside, loop.beside.horizon
    assign_rows(horizon.inputs, loop.kept_inputs)
    assign_rows(horizon.states, loop.kept_states)
    cost, _ = follow(mpc.prediction, horizon.weights, asked, loop.kept_inputs, horizon.simulated)
    follow(mpc.prediction, horizon.weights, asked, loop.inputs, horizon.simulated)
    adopt_plan(mpc, asked.disturbance, loop.inputs, horizon.simulated)
    solve_once(mpc, asked, loop.solved)
    if mpc.call[0].status == SOLVED:
        found, _ = follow(mpc.prediction, horizon.weights, asked, horizon.inputs, horizon.simulated)
        if found <= cost:
            return True
    adopt_plan(mpc, asked.disturbance, loop.kept_inputs, loop.kept_states)
    return False


@inner
def _show(loop: TrialLoop, k: int) -> None:
    """The outputs at the end of period k."""
    plant, m, p = loop.plant, loop.input_error.shape[0], loop.outputs.shape[1]
    drive, values = np.empty(2 * m + plant.stage.shape[1]), np.empty(loop.weights.outputs.shape[1])
    for j in range(m):
        drive[j] = loop.course.inputs[k, j] + loop.course.disturbances[k, j]
    for c in range(m, drive.shape[0]):
        drive[c] = 0.0
    call_value(plant.output, loop.course.states[k + 1], drive, plant.parameters, plant.network, plant.h, 0.0, values)
    for c in range(p):
        loop.outputs[k, c] = values[c]
