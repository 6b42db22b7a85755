"""A belief about the model's states and other unknowns: its prediction, expected readings and correction. Compiled.

    x+ = step(x, u + d + w; theta),  d+ = d,  (s, c)+ = rotation(2 pi f h) (s, c),  theta+ = theta
    y  = h(x, u + d; theta) + s

z = [x, d, hums, theta] of ``size`` entries: x the model's states, d an offset of each input and w its white noise, s
the hum of an output with its quadrature c, theta the followed parameters. Only x depends on inputs; process noise makes
the other entries drift. A belief is a mean (size,) and a root S (size, size) of its covariance, P = S S'.

Settings are one NumPy record ``core`` whose type is the same for every system, so that loops are compiled once. It
holds the addresses of arrays whose sizes depend on the system.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.core.addresses import matrix, numbers_at, vector
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array, Records

REACH = math.sqrt(6.0)
"""Reach of differences, in deviations. It captures the break-away of a joint that sticks, which sqrt(3), the best value
for smooth systems, often misses."""

EMPTY, GIVEN, USED, GATED, INITIALISED = 0, 1, 2, 3, 4
"""State of a reading: missing, not processed yet, used, gated as an outlier, or used for initialisation."""

_INTEGERS = (
    *("states", "inputs", "outputs", "channels", "size", "followed", "hums"),  # how many
    *("step", "output", "weights"),  # addresses of functions and weights
    *("windowed", "keep", "count", "at", "fresh", "wrong"),
    # addresses of arrays, whose shapes memory_of() has
    *("parameters", "followed_index", "low", "high", "start", "process", "input_noise", "delays", "turning", "applied"),
    *("means", "roots", "predicted", "filtered", "predicted_roots", "transitions"),
    *("rows", "sensitivity", "expected", "variance", "by_output", "shown", "above_shown", "below_shown"),
    *("point", "centre", "above", "below", "gain", "acting", "drive", "pushed", "z"),
)
_NUMBERS = ("longest_step", "slack", "span", "gate", "lead")
CORE = np.dtype([*((name, "i8") for name in _INTEGERS), *((name, "f8") for name in _NUMBERS)])
"""windowed: whether the method optimises over the last ``span`` [s]. count: moments in use, keep: how many stay when
memory is full, at: the moment of the last measurement, fresh: the first one that was made for it; wrong: inputs of that
measurement that were no numbers. An interval becomes ceil(interval / longest_step - slack) steps. lead [s]: how far
ahead an answer predicts. gate: largest normalised squared innovation that is accepted.
"""

CHANNEL = np.dtype([("state", "i8"), ("output", "i8"), ("hum", "i8"), ("noise", "f8")])
"""state: index of the measured state, -1: computed by the output map. hum: index of its sine in z, -1: none. noise:
variance.
"""

MOMENT = np.dtype([("time", "f8"), ("row", "i8")])
"""time [s]; row: index of its belief and readings in the arrays."""

READING = np.dtype([("value", "f8"), ("innovation", "f8"), ("normalised", "f8"), ("fate", "i8"), ("outliers", "i8")])
"""Reading of a channel at a moment: innovation before any reading of the moment, its normalised square after those of
earlier channels, and outliers: consecutive outliers so far.
"""


class Memory(NamedTuple):
    """First argument of kernels: records of the types above, and the past inputs. It is passed as a plain tuple, since
    Python passes a named one four times as slowly.
    """

    core: Records
    """(1,) of CORE."""
    channels: Records
    """(channels,) of CHANNEL: the outputs, then the tuning's further channels."""
    moments: Records
    """(capacity,) of MOMENT."""
    readings: Records
    """(capacity, channels) of READING."""
    inputs: Array
    """(length, 1 + inputs): end of an interval [s], integral of each input up to there; oldest first."""


@inner
def mean_of(core: Any, row: int) -> Array:
    """Mean (size,) of a belief."""
    return vector(core.means, core.size, row * core.size)


@inner
def root_of(core: Any, row: int) -> Array:
    """Root (size, size) of a belief's covariance."""
    return matrix(core.roots, core.size, core.size, row * core.size * core.size)


@inner
def copy(source: Array, target: Array) -> None:
    """Copy an array; an assignment of slices would take long to compile."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@inner
def copy_matrix(source: Array, target: Array) -> None:
    """Copy a matrix."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@inner
def clip_state(core: Any, mean: Array) -> None:
    """Limit states to their bounds."""
    low, high = numbers_at(core.low), numbers_at(core.high)
    for i in range(mean.shape[0]):
        mean[i] = min(max(mean[i], low[i]), high[i])


@inner
def confine(core: Any, root: Array) -> None:
    """Limit the deviation of each state to the one that is uniform between its bounds, (high - low) / sqrt(12)."""
    low, high = numbers_at(core.low), numbers_at(core.high)
    for i in range(core.states):
        width, square = high[i] - low[i], 0.0
        if width < math.inf:
            for j in range(root.shape[1]):
                square += root[i, j] * root[i, j]
            if 12.0 * square > width * width:
                share = width / math.sqrt(12.0 * square)
                for j in range(root.shape[1]):
                    root[i, j] *= share


@inner
def set_model(core: Any, z: Array, drive: Array) -> None:
    """Set the model's inputs and parameters to those of z."""
    n, m, size = core.states, core.inputs, z.shape[0]
    u = numbers_at(core.drive)
    for j in range(m):
        u[j] = drive[j] + z[n + j]
    if core.followed:
        parameters, which = numbers_at(core.parameters), numbers_at(core.followed_index)
        low, high, first = numbers_at(core.low), numbers_at(core.high), size - core.followed
        for i in range(first, size):
            parameters[int(which[i - first])] = min(max(z[i], low[i]), high[i])


@inner
def move(core: Any, z: Array, drive: Array, h: float, following: Array) -> None:
    """One step of h [s] of the model under the inputs ``drive`` (inputs,): ``following`` receives its states."""
    set_model(core, z, drive)
    parameters, weights, u = numbers_at(core.parameters), numbers_at(core.weights), numbers_at(core.drive)
    call_value(core.step, z, u, parameters, weights, h, 0.0, following)


@inner
def rest(core: Any, z: Array, h: float, following: Array) -> None:
    """The same step for the entries of z that do not depend on inputs."""
    first, size = core.states, z.shape[0]
    for i in range(first, size):
        following[i] = z[i]
    turning, at = numbers_at(core.turning), first + core.inputs
    for k in range(core.hums):
        angle = turning[k] * h
        cosine, sine = math.cos(angle), math.sin(angle)
        following[at] = cosine * z[at] + sine * z[at + 1]
        following[at + 1] = cosine * z[at + 1] - sine * z[at]
        at += 2


@inner
def add_process_noise(core: Any, rows: Array, count: int, h: float) -> int:
    """Append the rows of the root of Q h; return the new count."""
    process, size = numbers_at(core.process), rows.shape[1]
    for i in range(size):
        if process[i] > 0.0:
            for j in range(size):
                rows[count, j] = 0.0
            rows[count, i] = math.sqrt(process[i] * h)
            count += 1
    return count


@inner
def _show(core: Any, z: Array, shown: Array) -> None:
    """The output map at z."""
    set_model(core, z, vector(core.acting, core.inputs))
    parameters, weights, u = numbers_at(core.parameters), numbers_at(core.weights), numbers_at(core.drive)
    call_value(core.output, z, u, parameters, weights, core.longest_step, 0.0, shown)


@inner
def _map_outputs(core: Any, at: Array, root: Array) -> None:
    """The output map over the columns of the root, as in :func:`differences`: core.shown gets its mean (outputs,) and
    the variance of its second differences (outputs,), core.by_output (outputs, size) the first differences.
    """
    p, size = core.outputs, at.shape[0]
    shown, above, below = vector(core.shown, 2 * p), vector(core.above_shown, 2 * p), vector(core.below_shown, 2 * p)
    point, by_output = vector(core.point, size), matrix(core.by_output, p, size)
    _show(core, at, shown)
    for k in range(p):
        shown[p + k] = 0.0
        below[p + k] = shown[k]
    for i in range(size):
        for j in range(size):
            point[j] = at[j] + REACH * root[j, i]
        _show(core, point, above)
        for j in range(size):
            point[j] = at[j] - REACH * root[j, i]
        _show(core, point, below)
        for k in range(p):
            by_output[k, i] = (above[k] - below[k]) / (2.0 * REACH)
            second = (above[k] + below[k] - 2.0 * below[p + k]) / (REACH * REACH)
            shown[k] += 0.5 * second
            shown[p + k] += 0.5 * second * second


@inner
def expect(core: Any, channels: Records, readings: Records, at: Array, mean: Array, root: Array) -> None:
    """Expected readings of the channels that have one: core.expected and core.variance (channels,), with noise, and
    core.sensitivity (channels, size) by columns of the root. Maps are evaluated around ``at``, states at ``mean``.
    """
    size, count = at.shape[0], core.channels
    expected, variance, sensitivity = (
        numbers_at(core.expected),
        numbers_at(core.variance),
        matrix(core.sensitivity, count, size),
    )
    shown, by_output = numbers_at(core.shown), matrix(core.by_output, core.outputs, size)
    mapped = False
    for c in range(count):
        mapped = mapped or (readings[c].fate != EMPTY and channels[c].state < 0)
    if mapped:
        away = vector(core.z, size)
        for i in range(size):
            away[i] = mean[i] - at[i]
        if core.windowed:
            solve_triangular(root, away)
        _map_outputs(core, at, root)
        for k in range(core.outputs):
            for i in range(size):
                shown[k] += by_output[k, i] * away[i]
    for c in range(count):
        if readings[c].fate == EMPTY:
            continue
        state, output, hum = channels[c].state, channels[c].output, channels[c].hum
        variance[c] = channels[c].noise
        if state >= 0:
            expected[c] = mean[state]
            for i in range(size):
                sensitivity[c, i] = root[state, i]
        else:
            expected[c] = shown[output]
            variance[c] += shown[core.outputs + output]
            for i in range(size):
                sensitivity[c, i] = by_output[output, i]
        if hum >= 0:
            expected[c] += mean[hum]
            for i in range(size):
                sensitivity[c, i] += root[hum, i]


@inner
def solve_triangular(root: Array, x: Array) -> None:
    """S^-1 x in place, S lower triangular; entries without variance become zero."""
    for i in range(x.shape[0]):
        for k in range(i):
            x[i] -= root[i, k] * x[k]
        x[i] = x[i] / root[i, i] if root[i, i] != 0.0 else 0.0


@inner
def squared(root: Array, out: Array) -> None:
    """The covariance P = S S'."""
    size = root.shape[0]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(size):
                total += root[i, k] * root[j, k]
            out[i, j] = out[j, i] = total


@inner
def correct(core: Any, channels: Records, readings: Records, at: Array, mean: Array, root: Array, judge: bool) -> None:
    """Use a moment's readings (channels,) one after the other; judge: first decide which are outliers.

    The order is irrelevant for independent noise. The root's correction is Potter's: Kaminski, Bryson, Schmidt (1971),
    IEEE TAC 16(6), eq. (19); the rest Bar-Shalom, Li, Kirubarajan (2001), section 5.2. Maps are seen around ``at``.
    """
    count, size = core.channels, mean.shape[0]
    expected, noise = numbers_at(core.expected), numbers_at(core.variance)
    sensitivity, gain = matrix(core.sensitivity, count, size), numbers_at(core.gain)
    expect(core, channels, readings, at, mean, root)
    for c in range(count):
        if judge and readings[c].fate != EMPTY:
            readings[c].innovation = readings[c].value - expected[c]
    for c in range(count):
        reading, a = readings[c], sensitivity[c]
        if reading.fate == EMPTY or reading.fate == INITIALISED:
            continue
        innovation = reading.value - expected[c]  # (1) y - h(z)
        variance = noise[c]
        for i in range(size):
            variance += a[i] * a[i]  # (2) V = R + a' a,  a = S' H'
        if judge or reading.fate == GIVEN:
            reading.normalised = innovation * innovation / variance
            reading.fate = USED if reading.normalised <= core.gate else GATED
            reading.outliers = 0 if reading.fate == USED else reading.outliers + 1
        if reading.fate != USED:
            continue
        for i in range(size):
            gain[i] = 0.0
            for j in range(size):
                gain[i] += root[i, j] * a[j]
            mean[i] += gain[i] * innovation / variance  # (3) z += S a (y - h) / V
        share = 1.0 / (variance + math.sqrt(noise[c] * variance))
        for i in range(size):
            for j in range(size):
                root[i, j] -= share * gain[i] * a[j]  # (4) S (I - g a a'),  g = 1 / (V + sqrt(R V))
        for other in range(c + 1, count):  # (5) and the expected readings of the others
            if readings[other].fate != EMPTY:
                common = 0.0
                for i in range(size):
                    common += sensitivity[other, i] * a[i]
                expected[other] += common * innovation / variance
                for i in range(size):
                    sensitivity[other, i] -= share * common * a[i]
