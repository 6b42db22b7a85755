"""A period of a loop as kernels: estimator, stabiliser, and the controller's own kernels.

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
from hybrid_sysid_ros.control.safety import guarding
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
from hybrid_sysid_ros.estimation.belief import copy, numbers_at
from hybrid_sysid_ros.estimation.monitored_estimator import (
    DIVERGED,
    agrees,
    may_try,
    screen,
    time_to_judge,
    watch_estimate,
)
from hybrid_sysid_ros.estimation.reversed_input import NONE, believe_other, may_compete, outweighs, turn_input
from hybrid_sysid_ros.estimation.sensor_monitor import (
    doubt_of,
    is_any_left_out,
    judge_sensors,
    readmit,
    renew,
    without,
)
from hybrid_sysid_ros.extensions.export.unit.estimator_kernels import estimate, loosen, show
from hybrid_sysid_ros.extensions.export.unit.printed_loop import RESTED, WAITING, PrintedLoop
from hybrid_sysid_ros.support.arrays import Array

TRIAL, SAME, OTHER = 1, 2, 3
"""Which further estimate: the one that tries a sensor, and those that compete about the sign of an input."""
RESTING = 3
"""The level of :class:`~hybrid_sysid_ros.control.safety.failsafe.LoopState`."""


def observe(loop: PrintedLoop, time: float) -> bool:
    """The estimate of a measurement at ``time`` [s]; False while there is none."""
    progress, monitor, reversal = loop.progress[0], loop.monitor, loop.monitor.reversal
    watch, sensors = monitor.watch[0], monitor.sensors
    given = np.zeros(len(loop.applied))
    copy(loop.applied, given)
    turn_applied(loop)
    any_left = screen(sensors, monitor.detectors, monitor.ring, loop.outputs, monitor.shown)
    if watch.astray and any_left:
        watch.astray = False
        forget_estimate(loop)
        renew(sensors)
    if not estimate(loop, time):
        progress.status = WAITING
        copy(given, loop.applied)
        return False
    progress.elapsed = 0.0
    if math.isfinite(time):
        first = math.isnan(progress.answered)
        progress.elapsed = loop.settings.period if first else max(time - progress.answered, 0.0)
        progress.answered = time if first else max(time, progress.answered)
    _take_over(loop)
    if math.isfinite(time):
        elapsed = time_to_judge(watch, time)
        if elapsed > 0.0:
            _watch(loop, elapsed)
            if (
                len(monitor.trial) > 0
                and is_any_left_out(sensors)
                and may_try(monitor.trial[0], sensors, monitor.shown)
            ):
                _try_again(loop, time, elapsed)
            if len(reversal) > 0 and may_compete(reversal[0], sensors, monitor.shown, monitor.reversible, elapsed):
                _compete(loop, time, elapsed)
    progress.doubt = max(doubt_of(sensors), DIVERGED if watch.diverged else 0.0)
    progress.without = float(without(monitor.core[0], sensors))
    progress.reversed = float(NONE)
    if len(reversal) > 0:
        progress.reversed = float(reversal[0].reversed)
        progress.without += 0.0 if reversal[0].reversed == NONE else 1.0
    copy(given, loop.applied)
    return True


def turn_applied(loop: PrintedLoop) -> None:
    """Make of applied inputs what acts of them, or the reverse."""
    if len(loop.monitor.reversal) > 0:
        turn_input(loop.applied, loop.monitor.reversal[0].reversed)


def _take_over(loop: PrintedLoop) -> None:
    """Take the newest estimate for the instance that is to be solved."""
    core, out, instance = loop.memory[0][0], loop.out, loop.instance
    n, m = core.states, core.inputs
    for a in range(n):
        instance.state[a] = out[n + a]
    for j in range(m):
        instance.disturbance[j] = out[2 * n + j]
        for i in range(core.followed):
            deviation = out[2 * n + m + i] - loop.initial.parameters[i]
            instance.disturbance[j] += deviation * loop.initial.offsets[i, j]


def _watch(loop: PrintedLoop, elapsed: float) -> None:
    """Judge sensors and estimate by the newest update."""
    core, out, monitor = loop.memory[0][0], loop.out, loop.monitor
    first = 2 * core.states + core.inputs + core.followed + core.outputs + 1
    out_before = _times_left_out(loop)
    expected = np.zeros(core.outputs)
    if is_any_left_out(monitor.sensors):
        expect(loop, expected)
    judge_sensors(monitor.core[0], monitor.sensors, monitor.shown, out[first : first + core.outputs], expected, elapsed)
    if _times_left_out(loop) > out_before:
        loosen(loop)
        if len(monitor.trial) > 0:
            monitor.trial[0].agreed = math.nan
    watch_estimate(monitor.watch[0], monitor.sensors, loop.instance.disturbance, monitor.limits, elapsed)


def exchange(loop: PrintedLoop, which: int) -> None:
    """Let a further estimate be the loop's, and that one the further one. In C it is a pointer; Python has objects."""
    raise NotImplementedError


def _try_again(loop: PrintedLoop, time: float, elapsed: float) -> None:
    """Use all sensors again once the second estimate, which begins anew where they contradict it, agrees with all."""
    core, out, monitor, resets = loop.memory[0][0], loop.out, loop.monitor, loop.progress[0].resets
    tried, first = monitor.trial[0], 2 * core.states + core.inputs + core.followed + core.outputs + 1
    before = np.zeros(len(out))
    copy(out, before)
    exchange(loop, TRIAL)
    if math.isnan(tried.agreed):
        forget_estimate(loop)
        renew(monitor.agreement)
        tried.agreed = 0.0
    copy(monitor.shown, loop.outputs)
    estimate(loop, time)
    normalised = out[first : first + core.outputs]
    if agrees(tried, monitor.core[0], monitor.agreement, monitor.shown, normalised, elapsed):
        readmit(monitor.sensors)
    else:
        exchange(loop, TRIAL)
    copy(before, out)
    loop.progress[0].resets = resets


def _compete(loop: PrintedLoop, time: float, elapsed: float) -> None:
    """Update the two that compete, as :meth:`.monitored_estimator.MonitoredEstimator._compete`."""
    core, out, monitor, resets = loop.memory[0][0], loop.out, loop.monitor, loop.progress[0].resets
    trial, first = monitor.reversal[0], 2 * core.states + core.inputs + core.followed + core.outputs + 1
    before, same, anew = np.zeros(len(out)), np.zeros(core.outputs), math.isnan(trial.ratio)
    copy(out, before)
    if anew:
        renew(monitor.judge)
        trial.ratio = trial.sound = 0.0
    exchange(loop, SAME)
    _update_rival(loop, time, anew)
    copy(out[first : first + core.outputs], same)
    exchange(loop, SAME)
    exchange(loop, OTHER)
    turn_input(loop.applied, trial.tried)
    _update_rival(loop, time, anew)
    normalised = out[first : first + core.outputs]
    if outweighs(trial, monitor.core[0], monitor.judge, monitor.shown, same, normalised, elapsed):
        believe_other(trial, monitor.sensors)
        monitor.watch[0].doubted = 0.0
        if len(monitor.trial) > 0:
            monitor.trial[0].agreed = math.nan
        _take_over(loop)
    else:
        exchange(loop, OTHER)
        turn_input(loop.applied, trial.tried)
        copy(before, out)
    loop.progress[0].resets = resets


def _update_rival(loop: PrintedLoop, time: float, anew: bool) -> None:
    if anew:
        forget_estimate(loop)
    copy(loop.monitor.shown, loop.outputs)
    estimate(loop, time)


def _times_left_out(loop: PrintedLoop) -> int:
    sensors, total = loop.monitor.sensors, 0
    for k in range(len(sensors)):
        total += sensors[k].count
    return total


def judge(loop: PrintedLoop) -> None:
    """The level that the newest estimate allows, and what acted as a measurement says."""
    core, progress, n = loop.memory[0][0], loop.progress[0], loop.memory[0][0].states
    ahead = loop.out[n : n + core.states]
    doubt, missing, which = progress.doubt, progress.without, progress.reversed
    turn_applied(loop)
    guarding.judge(loop.guard, doubt, missing, which, loop.applied, ahead, progress.elapsed)
    turn_applied(loop)


def expect(loop: PrintedLoop, shown: Array) -> None:
    """The readings (p,) that the newest estimate expects."""
    core, out = loop.memory[0][0], loop.out
    n, m, first = core.states, core.inputs, core.size - core.followed
    z = np.zeros(core.size)
    for a in range(n):
        z[a] = out[a]
    for j in range(m):
        z[n + j] = out[2 * n + j]
    for i in range(core.followed):
        z[first + i] = out[2 * n + m + i]
    show(loop, z, shown)


def expect_outputs(loop: PrintedLoop) -> None:
    """The readings that the newest estimate expects, in place of those that came."""
    expect(loop, loop.outputs)


def decide(loop: PrintedLoop, governed: bool) -> None:
    """The command for the newest estimate. governed: the reference may have to be led on."""
    progress, guard, m = loop.progress[0], loop.guard, len(loop.command)
    core = guard.core[0]
    inputs, rest = np.zeros(m), np.zeros(m)
    find_rest(loop, rest)
    guarding.turn(guard, loop.command)
    if core.level >= RESTING:
        progress.returning, progress.status = 1, RESTED
        assign(inputs, rest)
    else:
        if progress.returning != 0:
            progress.returning = 0
            forget_plan(loop)
            expect(loop, loop.outputs)
            come_back(guard.governor[0], guard.outputs, loop.outputs)
        if governed:
            guarding.govern(guard, core.level, loop.now, loop.preview, loop.times, progress.elapsed)
        assign(loop.instance.previous, loop.command)
        if loop.gains.shape[0] > 0:
            stabilise(loop, inputs)
        elif loop.on_way is not None:
            wait(loop, inputs)
        else:
            answer(loop)
            assign(inputs, loop.plan)
        if core.share < 1.0 or core.tried < 1.0:
            guarding.slow(guard, inputs, rest)
    guarding.limit_rates(guard, inputs, loop.command, progress.elapsed)
    assign(loop.command, inputs)
    guarding.remember(guard, loop.command)
    guarding.turn(guard, loop.command)
    progress.noted = 1


def find_rest(loop: PrintedLoop, inputs: Array) -> None:
    """Inputs at rest (m,), or those of the stabiliser, as :meth:`.guard.Guard.rest_of`."""
    guard, stabilised = loop.guard, loop.gains.shape[0] > 0
    assign(inputs, loop.at_rest)
    if stabilised:
        known = not guarding.doubts_actuators(guard, guard.failsafe[0].resting)
        for a in range(loop.gains.shape[1]):
            known = known and math.isfinite(loop.out[loop.gains.shape[1] + a])
        if known:
            for j in range(len(inputs)):
                inputs[j] = held(loop, j, 0.0)
            guarding.put_on_trial(guard, inputs)


def find_plan_at_rest(loop: PrintedLoop) -> None:
    """:func:`find_rest`, in place of the plan's first inputs."""
    find_rest(loop, loop.plan)
    guarding.turn(loop.guard, loop.plan)


def sent(loop: PrintedLoop) -> None:
    """Take in that the command that was sent is another one."""
    progress, guard, m = loop.progress[0], loop.guard, len(loop.command)
    guarding.turn(guard, loop.command)
    if progress.noted == 0:
        guarding.remember(guard, loop.command)
    for j in range(m):
        guard.sent[guard.core[0].row * m + j] = loop.command[j]
    guarding.turn(guard, loop.command)
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
    loop.progress[0].answered = math.nan


def forget_estimate(loop: PrintedLoop) -> None:
    """Begin an estimate anew with the next measurement."""
    stamps, core = loop.stamps[0], loop.memory[0][0]
    known = numbers_at(core.applied)
    for j in range(core.inputs):
        known[j] = 0.0
    stamps.started, stamps.last = 0, math.nan


def begin_control(loop: PrintedLoop) -> None:
    """Forget the last plan, and that the loop comes back."""
    forget_plan(loop)
    loop.progress[0].returning, loop.progress[0].noted = 0, 0


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
