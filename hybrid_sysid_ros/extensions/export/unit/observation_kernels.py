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
from hybrid_sysid_ros.estimation.monitored_estimator import (
    DIVERGED,
    agrees,
    may_try,
    screen,
    time_to_judge,
    watch_estimate,
)
from hybrid_sysid_ros.estimation.reversed_input import (
    NONE,
    acts_reversed,
    begin_trial,
    believe_other,
    may_compete,
    signed_roots,
    turn_input,
)
from hybrid_sysid_ros.estimation.sensor_monitoring import (
    doubt_of,
    go_on_alone,
    have_jumped,
    is_any_left_out,
    judge_sensors,
    readmit,
    renew,
    without,
)
from hybrid_sysid_ros.extensions.export.unit.estimator_kernels import estimate, loosen, show
from hybrid_sysid_ros.extensions.export.unit.printed_loop import WAITING, PrintedLoop
from hybrid_sysid_ros.support.arrays import Array

TRIAL, SAME, OTHER = 1, 2, 3
"""Which further estimate: the one that tries a sensor, and those that compete about the sign of an input."""


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
            _watch(loop, elapsed)
            if (
                len(monitor.trial) > 0
                and is_any_left_out(sensors)
                and may_try(monitor.trial[0], sensors, monitor.shown)
            ):
                _try_again(loop, time, elapsed)
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


def _watch(loop: PrintedLoop, elapsed: float) -> None:
    """Judge sensors and estimate by the newest update."""
    core, out, monitor = loop.memory[0][0], loop.out, loop.monitor
    first = 2 * core.states + core.inputs + core.followed + core.outputs + 1
    out_before = _times_left_out(loop)
    expected = np.zeros(core.outputs)
    if is_any_left_out(monitor.sensors):
        expect(loop, expected)
    judge_sensors(monitor.core[0], monitor.sensors, monitor.shown, out[first : first + core.outputs], expected, elapsed)
    go_on_alone(monitor.core[0], monitor.sensors, elapsed)
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
        _take_over(loop)
    else:
        exchange(loop, TRIAL)
        copy(before, out)
    loop.progress[0].resets = resets


def _compete(loop: PrintedLoop, time: float, elapsed: float) -> None:
    """Update the two that compete, as :meth:`.monitored_estimator.MonitoredEstimator._compete`."""
    core, out, monitor, resets = loop.memory[0][0], loop.out, loop.monitor, loop.progress[0].resets
    trial, first = monitor.reversal[0], 2 * core.states + core.inputs + core.followed + core.outputs + 1
    before, own, anew = np.zeros(len(out)), np.zeros(core.outputs), math.isnan(trial.product)
    copy(out, before)
    if anew:
        begin_trial(trial, monitor.judge)
    exchange(loop, SAME)
    _update_rival(loop, time, anew)
    copy(out[first : first + core.outputs], own)
    exchange(loop, SAME)
    exchange(loop, OTHER)
    turn_input(loop.applied, trial.tried)
    _update_rival(loop, time, anew)
    if acts_reversed(
        trial, monitor.core[0], monitor.judge, monitor.shown, own, out[first : first + core.outputs], elapsed
    ):
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


def forget_estimate(loop: PrintedLoop) -> None:
    """Begin an estimate anew with the next measurement."""
    stamps, core = loop.stamps[0], loop.memory[0][0]
    known = numbers_at(core.applied)
    for j in range(core.inputs):
        known[j] = 0.0
    stamps.started, stamps.last = 0, math.nan
