"""An estimator's update as kernels: what Python does around its compiled filter."""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.core.addresses import numbers_at, vector
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.estimation.belief import EMPTY, GATED, GIVEN, INITIALISED, USED, copy, mean_of, root_of, set_model
from hybrid_sysid_ros.estimation.extended_kalman_filter import predict
from hybrid_sysid_ros.estimation.initialisation import LONGEST_GAP
from hybrid_sysid_ros.estimation.measurement_sequence import BEGIN, LARGEST_INPUT, LOOK, LOST, MEASURE, ODD, filtered
from hybrid_sysid_ros.extensions.export.unit.printed_loop import PrintedLoop
from hybrid_sysid_ros.support.arrays import Array


def begin(loop: PrintedLoop, time: float) -> None:
    """Begin an estimate with the outputs of a measurement and constant inputs, without other knowledge."""
    cores, _, moments, readings, inputs = loop.memory
    core, known, initial = cores[0], numbers_at(cores[0].applied), loop.initial
    m, p, size = core.inputs, core.outputs, core.size
    core.count = 1
    moments[0].time = time
    for j in range(m):
        if abs(loop.applied[j]) <= LARGEST_INPUT:
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
    stamps = loop.stamps[0]
    stamps.newest, stamps.last, stamps.started = time, time, 1
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
    stamps = loop.stamps[0]
    elapsed, valid = time - stamps.last, 0
    for k in range(loop.outputs.shape[0]):
        if math.isfinite(loop.outputs[k]):
            valid += 1
    if not math.isfinite(time) or (stamps.started == 0 and valid == 0):
        return stamps.started != 0
    if stamps.started == 0:
        begin(loop, time)
    elif elapsed > 0.0 and elapsed <= LONGEST_GAP:
        since = stamps.last
        stamps.last = time
        _take(loop, time, since)
    elif valid == 0:
        answer_again(loop)
    elif elapsed > 0.0:
        loop.progress[0].resets += 1
        begin(loop, time)
    else:
        _take(loop, time, time)
    return True


def _take(loop: PrintedLoop, time: float, since: float) -> None:
    """Put a measurement in its place, and begin again where a sensor has been an outlier for too long."""
    progress, stamps, core = loop.progress[0], loop.stamps[0], loop.memory[0][0]
    code = filtered(loop.memory, MEASURE, time, since, 0, loop.outputs, loop.applied, loop.out, loop.P, predict)
    if time > stamps.newest:
        stamps.newest = time
    if code == LOST:
        progress.resets += 1
        _last_outputs(loop)
        applied = np.zeros(core.inputs)
        copy(loop.applied, applied)
        for j in range(core.inputs):
            loop.applied[j] = 0.0
        begin(loop, stamps.newest)
        copy(applied, loop.applied)
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
            first = 2 * core.states + core.inputs + core.followed
            innovations = np.zeros(2 * p + 1)
            copy(loop.out[first : first + 2 * p + 1], innovations)
            filtered(loop.memory, BEGIN, 0.0, 0.0, index, loop.outputs, loop.applied, loop.out, loop.P, predict)
            copy(innovations, loop.out[first : first + 2 * p + 1])


def answer_again(loop: PrintedLoop) -> None:
    """The newest estimate, without innovations."""
    filtered(loop.memory, LOOK, 0.0, 0.0, 0, loop.outputs, loop.applied, loop.out, loop.P, predict)


def loosen(loop: PrintedLoop) -> None:
    """Doubt the newest estimate as much as a first one; its mean stays. See :meth:`.estimator.Estimator.loosen`."""
    core, moments, size = loop.memory[0][0], loop.memory[2], loop.memory[0][0].size
    root, start = root_of(core, moments[core.count - 1].row), numbers_at(core.start)
    for i in range(size):
        total = 0.0
        for j in range(size):
            total += root[i, j] * root[i, j]
            root[i, j] = 0.0
        root[i, i] = math.hypot(math.sqrt(total), start[i])


def _last_outputs(loop: PrintedLoop) -> None:
    """The newest reading of each output, 0 where there was none, in place of the measurement."""
    cores, _, moments, readings, _ = loop.memory
    for c in range(cores[0].outputs):
        loop.outputs[c] = 0.0
        for k in range(cores[0].count):
            if readings[moments[k].row, c].fate != EMPTY:
                loop.outputs[c] = readings[moments[k].row, c].value
