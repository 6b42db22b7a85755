"""A period of a loop as kernels: what estimator and controller do in Python around their compiled functions.

They are written in the subset that is translated to C, and numba never compiles them. An export compares them with
Python's classes, call by call.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.cascade import ROUNDING
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.mpc.quadratic_program import Program, clear_working_set, factorise
from hybrid_sysid_ros.control.mpc.shooting import plan_within, prepare_program, shift, solve_call
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.estimation.belief import (
    EMPTY,
    GATED,
    GIVEN,
    INITIALISED,
    USED,
    copy,
    mean_of,
    numbers_at,
    root_of,
    set_model,
    vector,
)
from hybrid_sysid_ros.estimation.extended_kalman_filter import predict
from hybrid_sysid_ros.estimation.initialisation import LONGEST_GAP
from hybrid_sysid_ros.estimation.measurement_sequence import BEGIN, LOOK, LOST, MEASURE, ODD, filtered
from hybrid_sysid_ros.support.arrays import Array

PROGRESS = np.dtype(
    [
        *((name, "i8") for name in ("started", "cold", "prepared", "planned", "fresh")),
        *((name, "i8") for name in ("status", "iterations", "resets")),
        *((name, "f8") for name in ("last", "newest", "residual", "age")),
    ]
)
"""What a loop remembers beside its arrays: stamps [s] of the last measurement and of the newest one, the age of a plan
below which a stabiliser acts.
"""

WAITING, SOLVED, ITERATED, NOT_CONVERGED, FAILED, HELD = range(6)
"""How a command was found; waiting: there is no estimate yet."""


class LoopNumbers(NamedTuple):
    """Numbers of a loop that are known when it is printed."""

    period: float
    """Of the measurements [s]."""
    interval: float
    """Of the controller's horizon [s]."""
    patience: int
    real_time: bool
    tolerance: float
    iterations: int


class InitialStates(NamedTuple):
    """Initial states from the first measurement, offset + by_outputs y + by_inputs u, and parts of the belief."""

    offset: Array
    """(n,)."""
    by_outputs: Array
    """(n, p)."""
    by_inputs: Array
    """(n, m)."""
    parameters: Array
    """(followed,): first values."""
    offsets: Array
    """(followed, m): offset of each input per deviation of a followed parameter."""


class PrintedLoop(NamedTuple):
    """The objects of a loop, as Python made them."""

    progress: Any
    """(1,) of :data:`PROGRESS`."""
    settings: LoopNumbers
    initial: InitialStates
    memory: Any
    outputs: Array
    """(p,), of the newest measurement."""
    applied: Array
    """(m,), mean inputs since the one before."""
    out: Array
    P: Array
    prediction: PredictionModel
    horizon: Horizon
    program: Program
    instance: Instance
    plan: Array
    """(m,), the controller's own inputs."""
    command: Array
    """(m,), what the rig gets: the same, or with a stabiliser what that makes of them."""
    gains: Array
    """(m, n) of the stabiliser; without rows where there is none."""
    low: Array
    """(m,), lowest commands of a stabiliser."""
    high: Array
    """(m,)."""


def begin(loop: PrintedLoop, time: float) -> None:
    """Begin an estimate with the outputs of a measurement and constant inputs, without other knowledge."""
    cores, _, moments, readings, inputs = loop.memory
    core, known, initial = cores[0], numbers_at(cores[0].applied), loop.initial
    m, p, size = core.inputs, core.outputs, core.size
    core.count = 1
    moments[0].time = time
    for j in range(m):
        if math.isfinite(loop.applied[j]):
            known[j] = loop.applied[j]
    for i in range(inputs.shape[0]):
        back = float(i + 1 - inputs.shape[0])
        inputs[i, 0] = time + back
        for j in range(m):
            inputs[i, 1 + j] = back * known[j]
    row = moments[0].row
    for c in range(p):
        readings[row, c].fate = EMPTY
        if math.isfinite(loop.outputs[c]):
            readings[row, c].value, readings[row, c].fate = loop.outputs[c], GIVEN
    mean, deviations, lost, initialised = np.zeros(size), np.zeros(size), np.zeros(p), np.zeros(p)
    for i in range(core.followed):
        mean[size - core.followed + i] = initial.parameters[i]
    _believe(loop, row, lost, mean, deviations, initialised)
    _write(loop, row, mean, deviations, initialised)
    progress = loop.progress[0]
    progress.newest, progress.last, progress.started = time, time, 1
    filtered(loop.memory, BEGIN, 0.0, 0.0, 0, loop.outputs, loop.applied, loop.out, loop.P, predict)


def _believe(loop: PrintedLoop, row: int, lost: Array, mean: Array, deviations: Array, initialised: Array) -> None:
    """Mean, as it was before, and deviations (size,) from the readings of a moment; initialised (channels,): 1 for
    those that they contain. lost (channels,): 1 for those that come before others of the same state.
    """
    cores, channels, _, readings, _ = loop.memory
    core, start = cores[0], numbers_at(cores[0].start)
    known, initial = numbers_at(core.applied), loop.initial
    n, m, p, size = core.states, core.inputs, core.outputs, core.size
    shown, taken = np.zeros(p), np.zeros(n)
    show(loop, mean, shown)
    for k in range(p):
        if readings[row, k].fate != EMPTY:
            shown[k] = readings[row, k].value
        elif not math.isfinite(shown[k]):
            shown[k] = 0.0
    for i in range(size):
        deviations[i] = start[i]
    for i in range(n + m, size - core.followed):
        mean[i] = 0.0
    for a in range(n):
        mean[a] = initial.offset[a]
        for k in range(p):
            mean[a] += initial.by_outputs[a, k] * shown[k]
        for j in range(m):
            mean[a] += initial.by_inputs[a, j] * known[j]
    for turn in range(2):
        for c in range(p):
            state, hum = channels[c].state, channels[c].hum
            first = lost[c] > 0.0
            if first == (turn == 0) and readings[row, c].fate != EMPTY and state >= 0 and taken[state] == 0.0:
                taken[state] = initialised[c] = 1.0
                mean[state] = readings[row, c].value
                amplitude = start[hum] if hum >= 0 else 0.0
                deviations[state] = math.hypot(math.sqrt(channels[c].noise), amplitude)


def _write(loop: PrintedLoop, row: int, mean: Array, deviations: Array, initialised: Array) -> None:
    """Write the belief; a sensor without readings so far may overrule it with its first value."""
    cores, _, _, readings, _ = loop.memory
    core = cores[0]
    for c in range(core.outputs):
        given = readings[row, c].fate != EMPTY
        readings[row, c].outliers = 0 if given else loop.settings.patience
        if given:
            readings[row, c].fate = INITIALISED if initialised[c] > 0.0 else GIVEN
    copy(mean, mean_of(core, row))
    root = root_of(core, row)
    for i in range(core.size):
        for j in range(core.size):
            root[i, j] = deviations[i] if i == j else 0.0


def show(loop: PrintedLoop, z: Array, shown: Array) -> None:
    """Readings of each output at z (size,) without hum."""
    cores, channels, _, _, _ = loop.memory
    core = cores[0]
    drive, mapped = vector(core.applied, core.inputs), np.zeros(core.outputs)
    set_model(core, z, drive)
    u, parameters, weights = numbers_at(core.drive), numbers_at(core.parameters), numbers_at(core.weights)
    call_value(core.output, z, u, parameters, weights, 0.0, 0.0, mapped)
    for c in range(core.outputs):
        shown[c] = z[channels[c].state] if channels[c].state >= 0 else mapped[c]


def _add_variance(loop: PrintedLoop, z: Array, root: Array, variance: Array) -> None:
    """Add the variance of each reading around z (size,), by the columns of a root (size, size)."""
    core = loop.memory[0][0]
    size, p = core.size, core.outputs
    point, above, below = np.zeros(size), np.zeros(p), np.zeros(p)
    for i in range(size):
        for j in range(size):
            point[j] = z[j] + root[j, i]
        show(loop, point, above)
        for j in range(size):
            point[j] = z[j] - root[j, i]
        show(loop, point, below)
        for c in range(p):
            variance[c] += (above[c] - below[c]) * (above[c] - below[c]) / 4.0


def begin_from(loop: PrintedLoop, index: int, lost: Array) -> bool:
    """Prepare to begin again at a moment, from its readings, because the channels ``lost`` were outliers for too long;
    False where another channel contradicts them that was accepted meanwhile.
    """
    cores, channels, moments, readings, _ = loop.memory
    core = cores[0]
    p, size, row = core.outputs, core.size, moments[index].row
    before, mean, deviations, diagonal = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros((size, size))
    initialised, shown, earlier, variance = np.zeros(p), np.zeros(p), np.zeros(p), np.zeros(p)
    copy(mean_of(core, row), before)
    copy(before, mean)
    _believe(loop, row, lost, mean, deviations, initialised)
    show(loop, mean, shown)
    show(loop, before, earlier)
    for i in range(size):
        diagonal[i, i] = deviations[i]
    for c in range(p):
        variance[c] = channels[c].noise
    _add_variance(loop, mean, diagonal, variance)
    _add_variance(loop, before, root_of(core, row), variance)
    run = 0
    for k in range(index + 1):
        for c in range(p):
            fate = readings[moments[k].row, c].fate
            if lost[c] > 0.0 and fate in (USED, INITIALISED):
                run = max(run, k + 1)
    for c in range(p):
        accepted = False
        for k in range(run, index + 1):
            fate = readings[moments[k].row, c].fate
            if fate != EMPTY:
                accepted = fate in (USED, INITIALISED)
        change = shown[c] - earlier[c]
        if not lost[c] > 0.0 and accepted and change * change > core.gate * variance[c]:
            return False
    _write(loop, row, mean, deviations, initialised)
    return True


def estimate(loop: PrintedLoop, time: float) -> bool:
    """Update the estimate by a measurement at ``time`` [s]; False while there is none."""
    progress = loop.progress[0]
    elapsed, valid = time - progress.last, 0
    for k in range(loop.outputs.shape[0]):
        if math.isfinite(loop.outputs[k]):
            valid += 1
    if not math.isfinite(time) or (progress.started == 0 and valid == 0):
        return progress.started != 0
    if progress.started == 0:
        begin(loop, time)
    elif elapsed > 0.0 and elapsed <= LONGEST_GAP:
        since = progress.last
        progress.last = time
        _take(loop, time, since)
    elif valid == 0:
        filtered(loop.memory, LOOK, 0.0, 0.0, 0, loop.outputs, loop.applied, loop.out, loop.P, predict)
    elif elapsed > 0.0:
        progress.resets += 1
        begin(loop, time)
    else:
        _take(loop, time, time)
    return True


def _take(loop: PrintedLoop, time: float, since: float) -> None:
    """Put a measurement in its place, and begin again where a sensor has been an outlier for too long."""
    progress, core = loop.progress[0], loop.memory[0][0]
    code = filtered(loop.memory, MEASURE, time, since, 0, loop.outputs, loop.applied, loop.out, loop.P, predict)
    if time > progress.newest:
        progress.newest = time
    if code == LOST:
        progress.resets += 1
        _last_outputs(loop)
        for j in range(loop.applied.shape[0]):
            loop.applied[j] = 0.0
        begin(loop, progress.newest)
    elif code == ODD:
        _, _, moments, readings, _ = loop.memory
        index, p = core.at, core.outputs
        lost, row, any_lost = np.zeros(p), moments[core.at].row, False
        for c in range(p):
            outlier = math.isfinite(loop.outputs[c]) and readings[row, c].fate == GATED
            if outlier and readings[row, c].outliers > loop.settings.patience:
                lost[c] = 1.0
                any_lost = True
        if any_lost and begin_from(loop, index, lost):
            progress.resets += 1
            filtered(loop.memory, BEGIN, 0.0, 0.0, index, loop.outputs, loop.applied, loop.out, loop.P, predict)


def _last_outputs(loop: PrintedLoop) -> None:
    """The newest reading of each output, 0 where there was none, in place of the measurement."""
    cores, _, moments, readings, _ = loop.memory
    for c in range(cores[0].outputs):
        loop.outputs[c] = 0.0
        for k in range(cores[0].count):
            if readings[moments[k].row, c].fate != EMPTY:
                loop.outputs[c] = readings[moments[k].row, c].value


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


def hold(loop: PrintedLoop) -> None:
    """The previous inputs within their bounds, 0 or the nearest bound where they are no numbers."""
    limits = loop.horizon.limits
    for j in range(loop.plan.shape[0]):
        last = loop.instance.previous[j] if math.isfinite(loop.instance.previous[j]) else 0.0
        loop.plan[j] = min(max(last, limits.low[j]), limits.high[j])


def run_period(loop: PrintedLoop, time: float) -> None:
    """A period: the estimate of a measurement at ``time`` [s], and the command."""
    core, out, instance, progress = loop.memory[0][0], loop.out, loop.instance, loop.progress[0]
    n, m = core.states, core.inputs
    assign(instance.previous, loop.command)
    if not estimate(loop, time):
        progress.status = WAITING
        return
    for a in range(n):
        instance.state[a] = out[n + a]
    for j in range(m):
        instance.disturbance[j] = out[2 * n + j]
        for i in range(core.followed):
            deviation = out[2 * n + m + i] - loop.initial.parameters[i]
            instance.disturbance[j] += deviation * loop.initial.offsets[i, j]
    if loop.gains.shape[0] > 0:
        stabilise(loop)
    else:
        control(loop)
        assign(loop.command, loop.plan)


def stabilise(loop: PrintedLoop) -> None:
    """The command of the stabiliser below the controller, which plans once in each of its own periods."""
    progress, instance, gains = loop.progress[0], loop.instance, loop.gains
    m, n = gains.shape
    if progress.planned == 0 or progress.age > (1.0 - ROUNDING) * loop.settings.interval:
        for j in range(m):
            if progress.planned == 0:
                for a in range(n):
                    instance.previous[j] += gains[j, a] * instance.state[a]
            else:
                instance.previous[j] = loop.plan[j]
        control(loop)
        progress.planned, progress.fresh, progress.age = 1, 1, 0.0
    for j in range(m):
        u = 0.0
        for a in range(n):
            u += gains[j, a] * loop.out[n + a]
        u = loop.plan[j] - u
        loop.command[j] = min(max(0.0 if math.isnan(u) else u, loop.low[j]), loop.high[j])


def look_forward(loop: PrintedLoop, elapsed: float) -> None:
    """Prepare for the next period, ``elapsed`` [s] after this one."""
    progress = loop.progress[0]
    if loop.gains.shape[0] == 0:
        prepare(loop, elapsed)
        return
    progress.age += elapsed
    if progress.fresh != 0:
        progress.fresh = 0
        prepare(loop, loop.settings.interval)


def prepare(loop: PrintedLoop, elapsed: float) -> None:
    """Shift the plan, and in real time linearise there."""
    progress, settings = loop.progress[0], loop.settings
    if progress.cold != 0:
        return
    shift(loop.prediction, loop.horizon, min(elapsed / settings.interval, 1.0))
    if settings.real_time:
        prepare_program(loop.prediction, loop.horizon, loop.program)
        progress.prepared = 1 if factorise(loop.program) else 0


def begin_again(loop: PrintedLoop) -> None:
    """Forget the past; the last command holds."""
    progress, core = loop.progress[0], loop.memory[0][0]
    known = numbers_at(core.applied)
    for j in range(core.inputs):
        known[j] = 0.0
    clear_working_set(loop.program)
    progress.started, progress.cold, progress.prepared = 0, 1, 0
    progress.planned, progress.fresh, progress.last = 0, 0, math.nan
