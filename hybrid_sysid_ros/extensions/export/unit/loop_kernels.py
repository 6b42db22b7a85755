"""A period of a loop as kernels: guard, stabiliser, and the controller's own kernels.

They are written in the subset that is translated to C, and numba never compiles them. An export compares them with
Python's classes, call by call.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.cascade import ROUNDING
from hybrid_sysid_ros.control.mpc import calls
from hybrid_sysid_ros.control.mpc.calls import prepare_mpc, solve_instance
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.safety import commanding, guarding
from hybrid_sysid_ros.control.safety.governor import come_back, lead_from
from hybrid_sysid_ros.control.safety.supervision import answer_supervised, begin_supervision, prepare_supervised
from hybrid_sysid_ros.control.waiting_inputs import (
    add_effect,
    add_inputs,
    due_inputs,
    forget_inputs,
    let_inputs_age,
    planned_last,
)
from hybrid_sysid_ros.extensions.export.unit.observation_kernels import (
    exchange,
    expect,
    forget_bank,
    forget_estimate,
    turn_applied,
)
from hybrid_sysid_ros.extensions.export.unit.printed_loop import RESTED, PrintedLoop
from hybrid_sysid_ros.support.arrays import Array

RESTING = 3
"""The level of :class:`~hybrid_sysid_ros.control.safety.failsafe.LoopState`."""


def judge(loop: PrintedLoop) -> None:
    """The level that the newest estimate allows, and what acted as a measurement says."""
    core, progress, n = loop.memory[0][0], loop.progress[0], loop.memory[0][0].states
    ahead = loop.out[n : n + core.states]
    doubt, missing, which = progress.doubt, progress.without, progress.reversed
    turn_applied(loop)
    guarding.report(loop.guard, loop.applied, loop.instance.disturbance)
    guarding.judge(loop.guard, doubt, missing, which, loop.applied, ahead, progress.elapsed)
    turn_applied(loop)


def expect_outputs(loop: PrintedLoop) -> None:
    """The readings that the newest estimate expects, in place of those that came."""
    expect(loop, loop.outputs)


def decide(loop: PrintedLoop, governed: bool, alone: bool) -> None:
    """The command for the newest estimate. governed: the reference may have to be led on. alone: nobody else looks
    whether measurements come and answers are found.
    """
    progress, settings, guard, m = loop.progress[0], loop.settings, loop.guard, len(loop.command)
    core = guard.core[0]
    inputs, rest = np.zeros(m), np.zeros(m)
    find_rest(loop, rest)
    commanding.turn(guard, loop.command)
    if core.level >= RESTING:
        progress.returning, progress.status, progress.lost = 1, RESTED, 0.0
        assign(inputs, rest)
    elif alone and progress.stale > settings.stale_after:
        progress.status = calls.HELD
        assign(inputs, loop.command)
    else:
        keep_within_reach(loop)
        if progress.returning != 0 or guard.governor[0].slow:
            expect(loop, loop.outputs)
        if progress.returning != 0:
            progress.returning = 0
            forget_plan(loop)
            come_back(guard.governor[0], guard.outputs, loop.outputs)
        if governed:
            commanding.govern(guard, core.level, loop.now, loop.outputs, loop.preview, loop.times, progress.elapsed)
        assign(loop.instance.previous, loop.command)
        if loop.gains.shape[0] > 0:
            stabilise(loop, inputs)
        elif loop.on_way is not None:
            wait(loop, inputs)
        else:
            answer(loop)
            assign(inputs, loop.plan)
        if core.share < 1.0 or core.tried < 1.0:
            commanding.slow(guard, inputs, rest)
    if alone and core.level < RESTING:
        is_sound = progress.status != calls.FAILED and progress.status != calls.HELD
        progress.lost = 0.0 if is_sound else progress.lost + settings.period
        if progress.lost > settings.zero_after:
            progress.returning, progress.status = 1, RESTED
            assign(inputs, rest)
    commanding.make_up(guard, inputs)
    commanding.limit_rates(guard, inputs, loop.command, progress.elapsed)
    assign(loop.command, inputs)
    commanding.remember(guard, loop.command)
    commanding.turn(guard, loop.command)
    progress.noted = 1


def keep_within_reach(loop: PrintedLoop) -> None:
    """Keep the references within the rig's travel and validity."""
    low, high = loop.reach_low, loop.reach_high
    for k in range(low.shape[0]):
        loop.now[k] = min(max(loop.now[k], low[k]), high[k])
        for i in range(loop.times.shape[0]):
            at = i * low.shape[0] + k
            loop.preview[at] = min(max(loop.preview[at], low[k]), high[k])


def find_rest(loop: PrintedLoop, inputs: Array) -> None:
    """Inputs at rest (m,), or those of the stabiliser, as :meth:`.guard.Guard.rest_of`."""
    guard, stabilised = loop.guard, loop.gains.shape[0] > 0
    assign(inputs, loop.at_rest)
    if stabilised:
        known = guarding.may_stabilise(guard)
        for a in range(loop.gains.shape[1]):
            known = known and math.isfinite(loop.out[loop.gains.shape[1] + a])
        if known:
            for j in range(len(inputs)):
                inputs[j] = held(loop, j, 0.0)
            commanding.put_on_trial(guard, inputs)


def find_plan_at_rest(loop: PrintedLoop) -> None:
    """:func:`find_rest`, in place of the plan's first inputs."""
    find_rest(loop, loop.plan)
    commanding.turn(loop.guard, loop.plan)


def sent(loop: PrintedLoop) -> None:
    """Take in that the command that was sent is another one."""
    progress, guard, m = loop.progress[0], loop.guard, len(loop.command)
    commanding.turn(guard, loop.command)
    if progress.noted == 0:
        commanding.remember(guard, loop.command)
    for j in range(m):
        guard.sent[guard.core[0].row * m + j] = loop.command[j]
    commanding.turn(guard, loop.command)
    progress.noted = 0


def lead(loop: PrintedLoop) -> None:
    """Lead the reference on from the one of now."""
    lead_from(loop.guard.governor[0], loop.guard.outputs, loop.now)


def answer(loop: PrintedLoop) -> None:
    """The plan's first inputs, of the policy or of the exact MPC."""
    mpc = loop.mpc
    if loop.supervisor is None:
        solve_instance(mpc, loop.instance, mpc.iterations)
    else:
        answer_supervised(loop.supervisor, loop.instance, solve_instance, mpc.iterations)
    loop.progress[0].status = mpc.call[0].status
    assign(loop.plan, mpc.horizon.planned[0])


def held(loop: PrintedLoop, j: int, added: float) -> float:
    """An input of the stabiliser, plus an added one, within its limits."""
    n, total = loop.gains.shape[1], 0.0
    for a in range(n):
        total += loop.gains[j, a] * loop.out[n + a]
    u = added - total
    return min(max(0.0 if math.isnan(u) else u, loop.low[j]), loop.high[j])


def stabilise(loop: PrintedLoop, inputs: Array) -> None:
    """The command (m,) of the stabiliser below the controller, which plans once in each of its own periods."""
    progress, instance, gains = loop.progress[0], loop.instance, loop.gains
    m, n = gains.shape
    if progress.planned == 0 or progress.age > (1.0 - ROUNDING) * loop.mpc.interval:
        for j in range(m):
            if progress.planned == 0:
                for a in range(n):
                    instance.previous[j] += gains[j, a] * instance.state[a]
            else:
                instance.previous[j] = loop.plan[j]
        answer(loop)
        progress.planned, progress.fresh, progress.age = 1, 1, 0.0
    for j in range(m):
        inputs[j] = held(loop, j, loop.plan[j])


def wait(loop: PrintedLoop, inputs: Array) -> None:
    """The command (m,) where inputs wait for slower ones, as :class:`.waiting_inputs.WaitingInputs`."""
    instance, on_way = loop.instance, loop.on_way
    n = len(instance.state)
    for a in range(n):
        instance.state[a] = loop.out[n + a]
    add_effect(on_way, instance.disturbance, loop.command, instance.state)
    planned_last(on_way, instance.previous)
    answer(loop)
    add_inputs(on_way, loop.plan)
    due_inputs(on_way, loop.command, inputs)


def look_forward(loop: PrintedLoop, elapsed: float) -> None:
    """Prepare for the next period, ``elapsed`` [s] after this one."""
    progress = loop.progress[0]
    if progress.status == RESTED:
        return
    if loop.on_way is not None:
        let_inputs_age(loop.on_way, elapsed)
    if loop.gains.shape[0] == 0:
        prepare(loop, elapsed)
        return
    progress.age += elapsed
    if progress.fresh != 0:
        progress.fresh = 0
        prepare(loop, loop.mpc.interval)


def prepare(loop: PrintedLoop, elapsed: float) -> None:
    """Shift the plan, and in real time linearise there."""
    if loop.supervisor is None:
        prepare_mpc(loop.mpc, elapsed)
    else:
        prepare_supervised(loop.supervisor, loop.instance, elapsed, solve_instance, loop.mpc.iterations)


def rebase(loop: PrintedLoop) -> float:
    """Count time, and the integrals of inputs, from the newest measurement on; return its time until now [s]."""
    by = loop.stamps[0].newest
    _shift(loop, by)
    for which in range(1, loop.monitor.estimates):
        exchange(loop, which)
        _shift(loop, by)
        exchange(loop, which)
    loop.progress[0].answered -= by
    loop.monitor.watch[0].last -= by
    return by


def _shift(loop: PrintedLoop, by: float) -> None:
    """Count an estimate's time from ``by`` [s] on."""
    stamps, last = loop.stamps[0], loop.memory[4].shape[0] - 1
    cores, _, moments, _, inputs = loop.memory
    for k in range(cores[0].count):
        moments[k].time -= by
    for i in range(inputs.shape[0]):
        inputs[i, 0] -= by
    for j in range(1, inputs.shape[1]):
        whole = inputs[last, j]
        for i in range(inputs.shape[0]):
            inputs[i, j] -= whole
    stamps.newest -= by
    stamps.last -= by


def forget_measurements(loop: PrintedLoop) -> None:
    """Forget them all, and when they came."""
    forget_estimate(loop)
    if len(loop.monitor.trial) > 0:
        forget_bank(loop)
    loop.progress[0].answered, loop.progress[0].stale = math.nan, 0.0


def begin_control(loop: PrintedLoop) -> None:
    """Forget the last plan, and that the loop comes back."""
    forget_plan(loop)
    progress = loop.progress[0]
    progress.returning, progress.noted, progress.lost = 0, 0, 0.0


def forget_plan(loop: PrintedLoop) -> None:
    """Forget the last plan; the last command holds."""
    progress = loop.progress[0]
    progress.planned, progress.fresh = 0, 0
    if loop.on_way is not None:
        forget_inputs(loop.on_way)
    if loop.supervisor is None:
        calls.forget_plan(loop.mpc)
    else:
        begin_supervision(loop.supervisor)
