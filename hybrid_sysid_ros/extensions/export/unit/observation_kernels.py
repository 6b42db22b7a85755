"""A measurement's part of a period as kernels: the estimate, what watches it, and the further ones beside it.

They are written in the subset that is translated to C, and numba never compiles them. An export compares them with
Python's classes, call by call.
"""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.core.addresses import numbers_at
from hybrid_sysid_ros.estimation.belief import copy
from hybrid_sysid_ros.estimation.measurement_sequence import LARGEST_INPUT
from hybrid_sysid_ros.estimation.monitored_estimator import DIVERGED, is_any, screen, time_to_judge, watch_estimate
from hybrid_sysid_ros.estimation.reversed_input import (
    acts_reversed,
    begin_trial,
    believe_other,
    may_compete,
    signed_roots,
    turn_input,
)
from hybrid_sysid_ros.estimation.sensor_bank import agrees, explains, suspect, weigh
from hybrid_sysid_ros.estimation.sensor_monitoring import (
    NONE,
    doubt_of,
    go_on_alone,
    have_jumped,
    is_any_left_out,
    judge_sensors,
    only_left_out,
    readmit,
    renew,
    without,
)
from hybrid_sysid_ros.extensions.export.unit.estimator_kernels import answer_again, estimate, loosen, show
from hybrid_sysid_ros.extensions.export.unit.printed_loop import WAITING, PrintedLoop
from hybrid_sysid_ros.support.arrays import Array


def observe(loop: PrintedLoop, time: float) -> bool:
    """The estimate of a measurement at ``time`` [s]; False while there is none."""
    progress, monitor, reversal = loop.progress[0], loop.monitor, loop.monitor.reversal
    watch, sensors = monitor.watch[0], monitor.sensors
    given = np.zeros(len(loop.applied))
    copy(loop.applied, given)
    for j in range(len(given)):
        if not abs(given[j]) <= LARGEST_INPUT:  # it is not known
            loop.applied[j] = loop.command[j]
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
    progress.stale += loop.settings.period
    if math.isfinite(time):
        first = math.isnan(progress.answered)
        if first or time > progress.answered:
            progress.stale = 0.0
        progress.elapsed = loop.settings.period if first else max(time - progress.answered, 0.0)
        progress.answered = time if first else max(time, progress.answered)
    _take_over(loop)
    if math.isfinite(time):
        elapsed = time_to_judge(watch, time)
        if elapsed > 0.0:
            before = only_left_out(sensors)
            if len(monitor.trial) > 0:
                _update_bank(loop, before, time, elapsed)
            _judge_sensors(loop, elapsed)
            if len(monitor.trial) > 0:
                _choose(loop, before, elapsed)
            watch_estimate(watch, sensors, loop.instance.disturbance, monitor.limits, elapsed)
            if (
                len(reversal) > 0
                and not have_jumped(monitor.core[0])
                and may_compete(reversal[0], sensors, monitor.shown, monitor.reversible, elapsed)
            ):
                _compete(loop, time, elapsed)
    progress.doubt = max(doubt_of(sensors), DIVERGED if watch.diverged else 0.0)
    progress.without = float(without(monitor.core[0], sensors))
    progress.reversed = float(NONE)
    if len(reversal) > 0:
        progress.reversed = float(reversal[0].reversed)
        progress.without += 0.0 if reversal[0].reversed == NONE else 1.0
    copy(given, loop.applied)
    return True


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


def turn_applied(loop: PrintedLoop) -> None:
    """Make of applied inputs what acts of them, or the reverse."""
    if len(loop.monitor.reversal) > 0:
        turn_input(loop.applied, loop.monitor.reversal[0].reversed)


def _judge_sensors(loop: PrintedLoop, elapsed: float) -> None:
    """Judge sensors by the newest update, as :meth:`.monitored_estimator.MonitoredEstimator._judge`."""
    core, out, monitor = loop.memory[0][0], loop.out, loop.monitor
    first = 2 * core.states + core.inputs + core.followed + core.outputs + 1
    out_before, which = _times_left_out(loop), suspect(monitor.members, monitor.sensors)
    expected, stands_out = np.zeros(core.outputs), explains(monitor.members, which, core.inputs)
    if is_any_left_out(monitor.sensors):
        expect(loop, expected)
    judge_sensors(
        monitor.core[0],
        monitor.sensors,
        monitor.shown,
        out[first : first + core.outputs],
        expected,
        elapsed,
        which,
        stands_out,
    )
    go_on_alone(monitor.core[0], monitor.sensors, elapsed)
    newly = _times_left_out(loop) - out_before
    if len(monitor.trial) > 0 and newly > 0:
        monitor.trial[0].agreed = math.nan
    if newly > 1:
        loosen(loop)


def exchange(loop: PrintedLoop, which: int) -> None:
    """Let a further estimate be the loop's, and that one the further one. In C it is a pointer; Python has objects."""
    raise NotImplementedError


def _update_bank(loop: PrintedLoop, before: int, time: float, elapsed: float) -> None:
    """Update the bank, as :meth:`.monitored_estimator.MonitoredEstimator._others`."""
    core, out, monitor, resets = loop.memory[0][0], loop.out, loop.monitor, loop.progress[0].resets
    first = 2 * core.states + core.inputs + core.followed
    own, tried = np.zeros(len(out)), monitor.trial[0]
    copy(out, own)
    for k in range(len(monitor.members)):
        copy(monitor.shown, loop.outputs)
        if k != before:
            loop.outputs[k] = math.nan
        if monitor.members[k].place > 0 and is_any(loop.outputs):
            exchange(loop, monitor.members[k].place)
            if k == before and math.isnan(tried.agreed):
                forget_estimate(loop)
                renew(monitor.agreement)
                tried.agreed = 0.0
            estimate(loop, time)
            shift = first + core.outputs + 1
            if k == before:
                copy(out[shift : shift + core.outputs], monitor.whole)
            elif weigh(monitor.members, k, monitor.sensors, out[shift : shift + core.outputs], elapsed):
                forget_estimate(loop)
            exchange(loop, monitor.members[k].place)
    copy(own, out)
    loop.progress[0].resets = resets


def _choose(loop: PrintedLoop, before: int, elapsed: float) -> None:
    """Which estimate is the loop's from now on, as :meth:`.monitored_estimator.MonitoredEstimator._chosen`."""
    monitor, chosen = loop.monitor, only_left_out(loop.monitor.sensors)
    if before != NONE and before != chosen:
        _forget_further(loop, monitor.members[before].place)
    copy(monitor.shown, loop.outputs)
    if chosen != NONE and chosen != before:
        loop.outputs[chosen] = math.nan
    if chosen != NONE and not is_any(loop.outputs):
        chosen = NONE
    if chosen != NONE and chosen == before:
        core, is_back = monitor.core[0], monitor.sensors[chosen].is_back != 0
        if agrees(monitor.trial[0], core, monitor.agreement, monitor.shown, monitor.whole, is_back, elapsed):
            readmit(monitor.sensors)
        else:
            chosen = NONE
    if chosen != NONE:
        exchange(loop, monitor.members[chosen].place)
        answer_again(loop)
        _take_over(loop)


def _compete(loop: PrintedLoop, time: float, elapsed: float) -> None:
    """Update the two that compete, as :meth:`.monitored_estimator.MonitoredEstimator._compete`."""
    core, out, monitor, resets = loop.memory[0][0], loop.out, loop.monitor, loop.progress[0].resets
    trial, first = monitor.reversal[0], 2 * core.states + core.inputs + core.followed + core.outputs + 1
    before, own, anew = np.zeros(len(out)), np.zeros(core.outputs), math.isnan(trial.product)
    same, other = monitor.estimates - 2, monitor.estimates - 1
    copy(out, before)
    if anew:
        begin_trial(trial, monitor.judge)
    exchange(loop, same)
    _update_rival(loop, time, anew)
    copy(out[first : first + core.outputs], own)
    exchange(loop, same)
    exchange(loop, other)
    turn_input(loop.applied, trial.tried)
    _update_rival(loop, time, anew)
    if acts_reversed(
        trial, monitor.core[0], monitor.judge, monitor.shown, own, out[first : first + core.outputs], elapsed
    ):
        believe_other(trial, monitor.sensors)
        monitor.watch[0].doubted = 0.0
        forget_bank(loop)
        _take_over(loop)
    else:
        exchange(loop, other)
        turn_input(loop.applied, trial.tried)
        copy(before, out)
    loop.progress[0].resets = resets


def _update_rival(loop: PrintedLoop, time: float, anew: bool) -> None:
    """Update one of the two without a gate, and give its innovations in their deviations for their squares."""
    core, out = loop.memory[0][0], loop.out
    p, gate, first = core.outputs, core.gate, 2 * core.states + core.inputs + core.followed
    if anew:
        forget_estimate(loop)
    copy(loop.monitor.shown, loop.outputs)
    core.gate = math.inf
    estimate(loop, time)
    core.gate = gate
    signed_roots(out[first : first + p], out[first + p + 1 : first + 2 * p + 1])


def _times_left_out(loop: PrintedLoop) -> int:
    sensors, total = loop.monitor.sensors, 0
    for k in range(len(sensors)):
        total += sensors[k].count
    return total


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


def _forget_further(loop: PrintedLoop, which: int) -> None:
    """Begin one of the further estimates anew."""
    exchange(loop, which)
    forget_estimate(loop)
    exchange(loop, which)


def forget_bank(loop: PrintedLoop) -> None:
    """Begin all estimates without a sensor anew."""
    members = loop.monitor.members
    for k in range(len(members)):
        if members[k].place > 0:
            _forget_further(loop, members[k].place)


def forget_estimate(loop: PrintedLoop) -> None:
    """Begin an estimate anew with the next measurement."""
    stamps, core = loop.stamps[0], loop.memory[0][0]
    known = numbers_at(core.applied)
    for j in range(core.inputs):
        known[j] = 0.0
    stamps.started, stamps.last = 0, math.nan
