"""A period of the supervisor as kernels: the online check, one step of the exact MPC, and who answers.

Source of the check: Hose, Köhler, Zeilinger, Trimpe (2025), Approximate nonlinear model predictive control with
safety-augmented neural networks, IEEE TCST 33(6), algorithm 1; there the cost must fall, here it may rise within a
stated tolerance, since reference and disturbance change and a network is never exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.calls import (
    FAILED,
    HELD,
    ITERATED,
    POLICY,
    MpcMemory,
    adopt_plan,
    forget_plan,
    hold,
    linearise_plan,
    prepare_mpc,
)
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, follow, set_stage
from hybrid_sysid_ros.control.mpc.shooting import FEEDBACK, answer
from hybrid_sysid_ros.control.policy.kernels import inside, network_answer
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array

ACCEPTED, OUT_OF_RANGE, DISTURBED, INFEASIBLE, COSTLIER, WAITING, IMPROVED = range(7)
"""Results of a check; waiting: at the beginning, when there is no last plan to compare with, and after a rejection."""

INPUT_ROUNDING = 1e-9
"""Largest distance of an input from its bounds [its unit]."""

TIME_ROUNDING = 1e-6
"""Rounding of times, in periods."""

SUPERVISION = np.dtype([*((name, "i8") for name in ("waiting", "unsolved", "reason")), ("unplanned", "f8")])
"""For how many good answers a supervisor waits; whether the exact MPC has yet to solve what the network answered; the
result of the last check; the time since there was a plan [s].
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class SupervisorMemory(Shared):
    """A policy, the exact MPC behind it, and the tolerances between them: n states, m inputs, horizon N."""

    mpc: MpcMemory
    sizes: NDArray[np.int64]
    numbers: Array
    """Those of the policy, see :class:`~hybrid_sysid_ros.control.policy.kernels.Packed`."""
    disturbance: Array
    """Largest input disturbance, (m,)."""
    share: float
    floor: float
    violation: float
    patience: int
    noise: float
    """By how much the network's plan may cost more than a step's."""
    steps: int
    """Whether one step of the exact MPC is made."""
    step: Array
    """By how much that may move an input, (m,)."""
    flat: Array
    """The instance in a row, (n + 2 m + N p,)."""
    inputs: Array
    """The network's plan, (N, m)."""
    states: Array
    """(N + 1, n)."""
    cost: Array
    """(1,)."""
    kept_inputs: Array
    """The last plan, while a step is made from it, (N, m)."""
    kept_states: Array
    """(N + 1, n)."""
    kept_disturbance: Array
    """(m,)."""
    course: NDArray[np.void]
    """(1,) of :data:`SUPERVISION`."""


Solve = Callable[[MpcMemory, Instance, Any], None]
"""How an instance is solved, with what that needs: :func:`~hybrid_sysid_ros.control.mpc.calls.solve_instance` with its
iterations, or another.
"""


@inner
def begin_supervision(own: SupervisorMemory) -> None:
    """Forget the last plan."""
    forget_plan(own.mpc)
    course = own.course[0]
    course.unplanned, course.unsolved = 0.0, 0
    course.waiting = own.patience if own.steps != 0 else 0
    for i in range(own.inputs.shape[0]):
        for j in range(own.inputs.shape[1]):
            own.inputs[i, j] = math.nan


@inner
def answer_supervised(own: SupervisorMemory, instance: Instance, solve: Solve, needs: Any) -> None:
    """The policy's plan where it passes the check, else that of the exact MPC, the rest of its last one, or the last
    inputs; it is in ``planned`` of the horizon. instance: views of ``own.flat``.

    In real time with steps the exact MPC makes its step first, and the check compares with that: a period has one step
    whoever answers.
    """
    if own.steps != 0 and own.mpc.real_time != 0:
        solve(own.mpc, instance, needs)
        if not accept_beside_step(own, instance):
            fall_back(own, instance)
    elif not accept(own, instance):
        solve(own.mpc, instance, needs)
        fall_back(own, instance)


@inner
def accept_beside_step(own: SupervisorMemory, instance: Instance) -> bool:
    """Whether the policy answers in place of the exact MPC's step, which was just made and stays its plan: it does
    where they agree.

    The next step is made around the state that is given then: so no period prepares a program beside its own step.
    """
    mpc, course = own.mpc, own.course[0]
    mpc.horizon.progress[0].foreseen = 0
    course.unsolved, course.reason = 0, WAITING
    if mpc.call[0].status != ITERATED:  # a solution from a cold start, or none
        own.inputs[0, 0] = math.nan
        return False
    course.reason = simulate_policy(own, instance)
    if course.reason == ACCEPTED and not _agrees(own, mpc.horizon.last.inputs, mpc.horizon.progress[0].cost):
        course.reason = IMPROVED
    if course.reason != ACCEPTED:
        course.waiting = own.patience
    elif course.waiting > 0:
        course.reason = WAITING
    else:
        _take(own)
    return course.reason == ACCEPTED  # type: ignore[no-any-return]


@inner
def accept(own: SupervisorMemory, instance: Instance) -> bool:
    """Whether the policy answers, and its plan then."""
    course = own.course[0]
    course.unsolved = 0
    course.reason = _checked(own, instance)
    if course.reason != ACCEPTED:
        return False
    if own.steps == 0:
        adopt_plan(own.mpc, instance.disturbance, own.inputs, own.states)
    _take(own)
    return True


@inner
def _take(own: SupervisorMemory) -> None:
    """Answer by the policy's plan."""
    own.course[0].unplanned = 0.0
    own.mpc.call[0].status = POLICY
    assign_rows(own.inputs, own.mpc.horizon.planned)


@inner
def fall_back(own: SupervisorMemory, instance: Instance) -> None:
    """The answer of the exact MPC's last call, or the last inputs where there is no plan any more."""
    mpc, call, course = own.mpc, own.mpc.call[0], own.course[0]
    if call.status != FAILED:
        course.unplanned = 0.0
    elif call.cold != 0 or course.unplanned > (mpc.horizon.inputs.shape[0] - TIME_ROUNDING) * mpc.interval:
        call.status = HELD
        hold(mpc.horizon, instance)
    if course.waiting > 0 and course.reason == WAITING:
        course.waiting = course.waiting - 1 if _near(own, mpc.horizon.planned[0], own.inputs[0]) else own.patience


@inner
def prepare_supervised(own: SupervisorMemory, instance: Instance, elapsed: float, solve: Solve, needs: Any) -> None:
    """Prepare for the next call, ``elapsed`` [s] after this one: where the network drives with steps, the exact MPC
    solves what the network has answered.
    """
    course = own.course[0]
    course.unplanned += elapsed
    if course.unsolved != 0:
        course.unsolved = 0
        solve(own.mpc, instance, needs)
    prepare_mpc(own.mpc, elapsed)


@inner
def _checked(own: SupervisorMemory, instance: Instance) -> int:
    """The result of the check, and what is waited for."""
    course = own.course[0]
    if own.mpc.call[0].cold != 0:
        return WAITING
    reason = check(own, instance)
    if own.steps != 0 and reason == ACCEPTED and course.waiting == 0:
        reason = _stepped(own, instance)
    if reason != ACCEPTED:
        course.waiting = own.patience
    elif course.waiting > 0:
        return WAITING
    return reason


@inner
def check(own: SupervisorMemory, instance: Instance) -> int:
    """Check the policy's plan by :func:`simulate_policy` and against the shifted one of the exact MPC.

    It is accepted where it costs no more. The shifted plan's own violation does not count: otherwise each plan could
    violate bounds a little more than the last, and after a push the exact MPC may find a plan without a violation.
    """
    horizon, reason = own.mpc.horizon, simulate_policy(own, instance)
    if reason != ACCEPTED:
        return reason  # type: ignore[no-any-return]
    shifted, _ = follow(own.mpc.prediction, horizon.weights, instance, horizon.inputs, horizon.simulated)
    if not math.isfinite(shifted):
        return ACCEPTED
    return COSTLIER if own.cost[0] > (1.0 + own.share) * shifted + own.floor else ACCEPTED


@inner
def simulate_policy(own: SupervisorMemory, instance: Instance) -> int:
    """Write the policy's inputs, simulated states and cost.

    They are accepted where the instance is within the training range, the disturbance is not too large, and the plan's
    simulation is finite and keeps the bounds of inputs, of their changes and, within the tolerance, of states.
    """
    prediction, horizon = own.mpc.prediction, own.mpc.horizon
    if not network_answer(own.sizes, own.numbers, own.flat, own.inputs):
        return OUT_OF_RANGE
    for j in range(own.disturbance.shape[0]):
        if not abs(instance.disturbance[j]) <= own.disturbance[j]:
            return DISTURBED
    if not inside(own.sizes, own.numbers, own.flat):
        return OUT_OF_RANGE
    if not _bounded(instance, horizon, own.inputs) or not _allowed(prediction, horizon, instance, own.inputs):
        return INFEASIBLE
    own.cost[0], outside = follow(prediction, horizon.weights, instance, own.inputs, own.states)
    return ACCEPTED if math.isfinite(own.cost[0]) and outside <= own.violation else INFEASIBLE


@inner
def _bounded(instance: Instance, horizon: Horizon, inputs: Array) -> bool:
    """Whether inputs and their changes are within their bounds."""
    limits = horizon.limits
    for j in range(inputs.shape[1]):
        low, high, rate = limits.low[j], limits.high[j], limits.rate[j] + INPUT_ROUNDING
        before = min(max(instance.previous[j], low), high)
        for i in range(inputs.shape[0]):
            u = inputs[i, j]
            if not (low - INPUT_ROUNDING <= u <= high + INPUT_ROUNDING and abs(u - before) <= rate):
                return False
            before = u
    return True


@inner
def _allowed(prediction: PredictionModel, horizon: Horizon, instance: Instance, inputs: Array) -> bool:
    """Whether inputs keep the bounds of terms that hold without exception, for which the states don't matter."""
    limits, weights, drive = horizon.limits, horizon.weights, horizon.work.drive
    values, hard = np.empty(weights.outputs.shape[1]), False
    for r in range(limits.hard.shape[0]):
        hard = hard or limits.hard[r]
    for i in range(inputs.shape[0] if hard else 0):
        for j in range(inputs.shape[1]):
            drive[j] = inputs[i, j] + instance.disturbance[j]
        set_stage(prediction, i, instance.disturbance, drive)
        call_value(
            prediction.output,
            instance.state,
            drive,
            prediction.parameters,
            prediction.network,
            prediction.h,
            0.0,
            values,
        )
        for r in range(limits.values.shape[0]):
            k = limits.values[r]
            beyond = max(values[k] - weights.value_high[i, k], weights.value_low[i, k] - values[k])
            if limits.hard[r] and not beyond <= INPUT_ROUNDING:
                return False
    return True


@inner
def _stepped(own: SupervisorMemory, instance: Instance) -> int:
    """IMPROVED unless one step of the exact MPC and the network agree by :func:`_agrees`. The last plan stays."""
    mpc, horizon, near = own.mpc, own.mpc.horizon, False
    assign_rows(horizon.inputs, own.kept_inputs)
    assign_rows(horizon.states, own.kept_states)
    assign(own.kept_disturbance, horizon.disturbance)
    linearise_plan(mpc)
    if mpc.call[0].way == FEEDBACK:
        found = answer(mpc.prediction, horizon, mpc.program, instance, 1, mpc.tolerance, False, FEEDBACK, True)
        cost, _ = follow(mpc.prediction, horizon.weights, instance, horizon.planned, horizon.simulated)
        near = found.iterations > 0 and _agrees(own, own.kept_inputs, cost)
    adopt_plan(mpc, own.kept_disturbance, own.kept_inputs, own.kept_states)
    own.course[0].unsolved = 1 if near else 0
    return ACCEPTED if near else IMPROVED


@inner
def _agrees(own: SupervisorMemory, before: Array, cost: float) -> bool:
    """Whether a step of the exact MPC has left its last plan ``before`` (N, m) nearly as it was, and the network agrees
    with it in its first inputs and, but for the noise that is allowed, in its cost.

    A plan that a step moves, if only later on, may be far from the solution, so that nobody knows what the network
    should have answered.
    """
    planned = own.mpc.horizon.planned
    near = own.cost[0] <= cost + own.noise and _near(own, planned[0], own.inputs[0])
    for i in range(planned.shape[0]):
        near = near and _near(own, planned[i], before[i])
    return near  # type: ignore[no-any-return]


@inner
def _near(own: SupervisorMemory, one: Array, other: Array) -> bool:
    """Whether inputs (m,) differ by no more than the tolerance of a step."""
    near = True
    for j in range(one.shape[0]):
        near = near and abs(one[j] - other[j]) <= own.step[j]
    return near
