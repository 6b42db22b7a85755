"""A controller's answer as kernels: what Python does around its compiled functions, and a supervisor around these."""

from __future__ import annotations

import math

from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.mpc.quadratic_program import factorise
from hybrid_sysid_ros.control.mpc.shooting import follow, plan_within, prepare_program, solve_call
from hybrid_sysid_ros.control.safety import supervisor
from hybrid_sysid_ros.control.safety.supervisor import ACCEPTED, IMPROVED, TIME_ROUNDING
from hybrid_sysid_ros.control.safety.supervisor import WAITING as UNCHECKED
from hybrid_sysid_ros.extensions.export.unit.printed_loop import (
    FAILED,
    HELD,
    ITERATED,
    NOT_CONVERGED,
    POLICY,
    SOLVED,
    PrintedLoop,
    Supervision,
)
from hybrid_sysid_ros.support.arrays import Array


def control(loop: PrintedLoop) -> None:
    """The command for the newest estimate and the preview, from the last plan."""
    progress, settings, instance, horizon = loop.progress[0], loop.settings, loop.instance, loop.horizon
    iterate = settings.real_time and progress.prepared != 0 and progress.cold == 0
    progress.prepared = 0
    found = solve_call(
        loop.prediction, horizon, loop.program, instance, settings.iterations, settings.tolerance,
        progress.cold != 0, iterate, True,
    )  # fmt: skip
    progress.iterations, progress.residual = found.iterations, found.residual
    if found.iterations > 0:
        progress.cold = 0
        progress.status = SOLVED if found.solved else ITERATED if iterate else NOT_CONVERGED
        assign(loop.plan, horizon.planned[0])
    elif progress.cold == 0:
        progress.status = FAILED
        plan_within(horizon, instance)
        assign(loop.plan, horizon.planned[0])
    else:
        progress.status = FAILED
        hold(loop)


def supervise(loop: PrintedLoop, own: Supervision) -> None:
    """The policy's inputs where they pass the check, else those of :func:`control` or of the rest of its plan."""
    progress, interval = loop.progress[0], loop.settings.interval
    progress.unsolved = 0
    progress.reason = _checked(loop, own)
    if progress.reason == ACCEPTED:
        progress.unplanned = 0.0
        if not own.steps:
            _adopt(loop, loop.instance.disturbance, own.inputs, own.states)
        progress.status = POLICY
        assign(loop.plan, own.inputs[0])
        return
    control(loop)
    if progress.status != FAILED:
        progress.unplanned = 0.0
    elif progress.cold != 0 or progress.unplanned > (loop.horizon.inputs.shape[0] - TIME_ROUNDING) * interval:
        progress.status = HELD
        hold(loop)
    if progress.waiting > 0 and progress.reason == UNCHECKED:
        progress.waiting = progress.waiting - 1 if _near(own, loop.plan, own.inputs[0]) else own.patience


def _checked(loop: PrintedLoop, own: Supervision) -> int:
    """The result of the check, and what is waited for."""
    progress = loop.progress[0]
    if progress.cold != 0:
        return UNCHECKED
    reason = supervisor.check(
        own.policy, loop.prediction, loop.horizon, loop.instance, own.flat, own.limits, own.inputs, own.states, own.cost
    )
    if own.steps and reason == ACCEPTED and progress.waiting == 0:
        reason = _stepped(loop, own)
    if reason != ACCEPTED:
        progress.waiting = own.patience
    elif progress.waiting > 0:
        return UNCHECKED
    return reason


def _stepped(loop: PrintedLoop, own: Supervision) -> int:
    """Whether one step leaves the last plan nearly as it is, and the policy agrees with it."""
    progress, horizon, settings = loop.progress[0], loop.horizon, loop.settings
    for i in range(horizon.inputs.shape[0]):
        assign(own.kept_inputs[i], horizon.inputs[i])
    for i in range(horizon.states.shape[0]):
        assign(own.kept_states[i], horizon.states[i])
    assign(own.kept_disturbance, horizon.disturbance)
    ready = progress.prepared != 0
    if not ready:
        prepare_program(loop.prediction, horizon, loop.program)
        ready = factorise(loop.program)
    progress.prepared = 0
    near = False
    if ready:
        found = solve_call(
            loop.prediction, horizon, loop.program, loop.instance, 1, settings.tolerance, False, True, True
        )
        near = found.iterations > 0 and _near(own, horizon.planned[0], own.inputs[0])
        for i in range(horizon.planned.shape[0]):
            near = near and _near(own, horizon.planned[i], own.kept_inputs[i])
        if near:
            cost, _ = follow(loop.prediction, horizon.weights, loop.instance, horizon.planned, horizon.simulated)
            near = own.cost[0] <= cost + own.noise
    if not (near and settings.real_time):
        _adopt(loop, own.kept_disturbance, own.kept_inputs, own.kept_states)
        progress.unsolved = 1 if near else 0
    return ACCEPTED if near else IMPROVED


def _adopt(loop: PrintedLoop, disturbance: Array, inputs: Array, states: Array) -> None:
    """Take a plan as the last one."""
    progress, horizon = loop.progress[0], loop.horizon
    assign(horizon.disturbance, disturbance)
    for i in range(horizon.inputs.shape[0]):
        assign(horizon.inputs[i], inputs[i])
    for i in range(horizon.states.shape[0]):
        assign(horizon.states[i], states[i])
    progress.cold, progress.prepared = 0, 0


def _near(own: Supervision, one: Array, other: Array) -> bool:
    """Whether inputs (m,) differ by no more than the tolerance of a step."""
    near = True
    for j in range(one.shape[0]):
        near = near and abs(one[j] - other[j]) <= own.near[j]
    return near


def hold(loop: PrintedLoop) -> None:
    """The previous inputs within their bounds, 0 or the nearest bound where they are no numbers."""
    limits = loop.horizon.limits
    for j in range(loop.plan.shape[0]):
        last = loop.instance.previous[j] if math.isfinite(loop.instance.previous[j]) else 0.0
        loop.plan[j] = min(max(last, limits.low[j]), limits.high[j])
