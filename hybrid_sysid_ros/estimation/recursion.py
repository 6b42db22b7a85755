"""What a measurement does to a belief, and beliefs carried from moment to moment. Compiled.

A belief is a mean (size,) and a root (size, size) of its covariance. Functions with ``core`` take the parts of a
:class:`~.memory.Memory` by their names.
"""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.augmented import clip, copy, copy_matrix, expect, move
from hybrid_sysid_ros.estimation.memory import (
    BEGUN,
    EMPTY,
    GATED,
    GIVEN,
    SAME,
    USED,
    matrix,
    mean_of,
    numbers,
    root_of,
    vector,
)
from hybrid_sysid_ros.estimation.moments import acting, after, forget, place, remember
from hybrid_sysid_ros.estimation.square_root import squared
from hybrid_sysid_ros.support.arrays import Array, Records

MEASURE, BEGIN, LOOK = 0, 1, 2
"""Tasks: take in a measurement, begin at a moment, tell what is known."""

NOTHING = -1
"""In place of a moment: no belief has changed."""

FINE, ODD, LATE, LOST = 0, 1, 2, 3
"""Of a measurement: all of it was used; look at its readings; it came too late; nothing finite is left."""


@inner
def correct(core: Any, channels: Records, readings: Records, at: Array, mean: Array, root: Array, judge: bool) -> None:
    """Use a moment's readings (channels,) one after the other; judge: decide first which to believe.

    Independent noise makes the order indifferent. The root's correction is Potter's: Kaminski, Bryson, Schmidt (1971),
    IEEE TAC 16(6), eq. (19); the rest Bar-Shalom, Li, Kirubarajan (2001), section 5.2. ``at``: where maps are seen.
    """
    count, size = core.channels, mean.shape[0]
    expected, noise = numbers(core.expected), numbers(core.variance)
    sensitivity, gain = matrix(core.sensitivity, count, size), numbers(core.gain)
    expect(core, channels, readings, at, mean, root)
    for c in range(count):
        if judge and readings[c].fate != EMPTY:
            readings[c].innovation = readings[c].value - expected[c]
    for c in range(count):
        reading, a = readings[c], sensitivity[c]
        if reading.fate == EMPTY or reading.fate == BEGUN:
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
        for other in range(c + 1, count):  # (5) and what is expected of the others
            if readings[other].fate != EMPTY:
                common = 0.0
                for i in range(size):
                    common += sensitivity[other, i] * a[i]
                expected[other] += common * innovation / variance
                for i in range(size):
                    sensitivity[other, i] -= share * common * a[i]


@inner
def inputs_to(core: Any, moments: Records, inputs: Array, k: int) -> Array:
    """The inputs (inputs,) that act in the interval before a moment."""
    u, time = vector(core.acting, core.inputs), moments[k].time
    start = moments[k - 1].time if k > 0 else time - core.longest_step
    acting(core, inputs, start, time, u)
    return u


@inner
def count_on(readings: Records, before: int, row: int) -> None:
    """The outliers in a row so far."""
    for c in range(readings.shape[1]):
        readings[row, c].outliers = readings[before, c].outliers


@inner
def put(
    core: Any,
    moments: Records,
    readings: Records,
    inputs: Array,
    time: float,
    since: float,
    first: int,
    given: Array,
    applied: Array,
) -> int:
    """Put readings of the channels from ``first`` on in their place, and ``applied``, the mean inputs from ``since`` to
    ``time`` where that is later. Returns the first moment whose belief is another one now, NOTHING where they are late.
    """
    newest = moments[core.count - 1].time
    core.wrong = remember(core, inputs, time, applied) if time > since else 0
    if since >= time:
        oldest = newest - core.span
        if core.windowed:
            oldest = moments[min(after(moments, core.count, oldest - 2.0 * SAME), core.count - 1)].time
        if time < oldest - SAME:
            return NOTHING
    index = place(core, moments, readings, time, first, given)
    changed = after(moments, core.count, since) if since < min(time, newest) else core.count
    if index < 0:
        return changed if changed < core.count else NOTHING
    return min(changed, index, core.fresh)


@inner
def replay(
    core: Any, channels: Records, moments: Records, readings: Records, inputs: Array, first: int, predict: Any
) -> None:
    """The beliefs from a moment on, each from that before: predict(core, mean, root, u, h) and correct."""
    for k in range(first, core.count):
        row = moments[k].row
        mean, root = mean_of(core, row), root_of(core, row)
        u = inputs_to(core, moments, inputs, k)
        if k > 0:
            before = moments[k - 1].row
            copy(mean_of(core, before), mean)
            copy_matrix(root_of(core, before), root)
            count_on(readings, before, row)
            predict(core, mean, root, u, moments[k].time - moments[k - 1].time)
        else:  # the belief that everything began with
            for c in range(core.channels):
                if readings[row, c].fate == USED:
                    readings[row, c].fate = BEGUN
        correct(core, channels, readings[row], mean, mean, root, True)
        clip(core, mean)


@inner
def answer(
    core: Any, moments: Records, readings: Records, inputs: Array, changed: int, first: int, out: Array, P: Array
) -> int:
    """What became of a measurement of the channels from ``first`` on. ``out``: states, states ahead, disturbance,
    followed parameters, innovations of the outputs, sum of the normalised squares; ``P``: covariance (size, size).
    """
    n, m, p, size = core.states, core.inputs, core.outputs, core.size
    newest = moments[core.count - 1]
    mean = mean_of(core, newest.row)
    for i in range(n):
        out[i] = mean[i]
    _look_ahead(core, inputs, newest.time, mean, out)
    for j in range(m):
        out[2 * n + j] = mean[n + j]
    for i in range(core.followed):
        out[2 * n + m + i] = mean[size - core.followed + i]
    squared(root_of(core, newest.row), P)
    total, shown = 0.0, 2 * n + m + core.followed
    for i in range(shown):
        total += 0.0 * out[i]  # no zero where something is infinite or no number
    for i in range(size):
        for j in range(size):
            total += 0.0 * P[i, j]
    fine, used, row = True, 0, moments[core.at].row
    out[shown + p] = 0.0
    for k in range(p):
        out[shown + k] = math.nan
    for c in range(first, p if first < p else first + 1 if changed != NOTHING else 0):
        reading = readings[row, c]
        fine = fine and reading.fate == USED
        if reading.fate == USED or reading.fate == GATED:
            used += 1
            out[shown + p] += reading.normalised
            if c < p:
                out[shown + c] = reading.innovation
    if used == 0:
        out[shown + p] = math.nan
    if total != 0.0:
        return LOST
    if changed == NOTHING:
        for k in range(p + 1):
            out[shown + k] = math.nan
        return LATE
    return FINE if fine and core.wrong == 0 else ODD


@inner
def _look_ahead(core: Any, inputs: Array, time: float, mean: Array, out: Array) -> None:
    """The states when a command that answers acts, into out[states:]; the inputs until then are known already."""
    n, size = core.states, core.size
    z, following, u = vector(core.z, size), vector(core.centre, size), vector(core.acting, core.inputs)
    copy(mean, z)
    steps = 0 if core.lead <= 0.0 else math.ceil(core.lead / core.longest_step - core.slack)
    h = core.lead / steps if steps > 0 else 0.0
    for k in range(steps):
        acting(core, inputs, time + k * h, time + (k + 1) * h, u)
        move(core, z, u, h, following)
        for i in range(n):
            z[i] = following[i]
    for i in range(n):
        out[n + i] = z[i]


@inner
def begin(core: Any, channels: Records, moments: Records, readings: Records, inputs: Array, index: int) -> None:
    """Forget what was before a moment and begin there with its belief as it stands; readings that it has not taken in
    yet (GIVEN) correct it, whatever they show.
    """
    forget(core, moments, index)
    row, gate = moments[0].row, core.gate
    mean, root = mean_of(core, row), root_of(core, row)
    inputs_to(core, moments, inputs, 0)
    core.gate = math.inf
    correct(core, channels, readings[row], mean, mean, root, True)
    core.gate = gate
    clip(core, mean)
    for c in range(core.channels):
        if readings[row, c].fate != EMPTY:
            readings[row, c].fate = BEGUN


@inner
def filtered(
    memory: Any,
    task: int,
    time: float,
    since: float,
    first: int,
    given: Array,
    applied: Array,
    out: Array,
    P: Array,
    predict: Any,
) -> int:
    """What a filter does with a task, by its predict(core, mean, root, u, h): see :class:`~.estimator.Estimator`."""
    cores, channels, moments, readings, inputs = memory
    core, changed = cores[0], NOTHING
    if task == MEASURE:
        changed = put(core, moments, readings, inputs, time, since, first, given, applied)
    elif task == BEGIN:
        begin(core, channels, moments, readings, inputs, first)
        changed = 1
    if changed != NOTHING:
        replay(core, channels, moments, readings, inputs, changed, predict)
    return answer(core, moments, readings, inputs, changed if task == MEASURE else NOTHING, first, out, P)  # type: ignore[no-any-return]
