"""Measurements in the order of their times, in whatever order they come, and the beliefs that follow. Compiled.

Moments of time have readings of channels, and past inputs are kept too. A late measurement is inserted at its time, and
the beliefs from there on are computed again. Functions take the parts of a :class:`~.belief.Memory` by their names.
"""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.addresses import numbers_at, vector
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.belief import (
    EMPTY,
    GATED,
    GIVEN,
    INITIALISED,
    USED,
    clip_state,
    confine,
    copy,
    copy_matrix,
    correct,
    mean_of,
    move,
    root_of,
    squared,
)
from hybrid_sysid_ros.support.arrays import Array, Records

SAME = 1e-6
"""Stamps that differ by less [s] are equal."""

LARGEST_INPUT = 1e9
"""No rig may have an input beyond it. One counts as no number: beside it the integral of all others is rounding."""

MEASURE, BEGIN, LOOK = 0, 1, 2
"""Tasks: use a measurement, begin at a moment, answer the current estimate."""

NOTHING = -1
"""Returned in place of a moment: no belief has changed."""

FINE, ODD, LATE, LOST = 0, 1, 2, 3
"""Result of a measurement: all was used; examine its readings; it came too late; nothing finite is left."""


@inner
def place(core: Any, moments: Records, readings: Records, time: float, first: int, given: Array) -> int:
    """Put readings ``given`` of the channels from ``first`` on where their time belongs, NaN where there is none.

    Behind the newest moment come as many as the interval has steps, without readings but for the last. The beliefs from
    the returned index on are not those of the readings any more. -1: older than all moments, or all there already.
    """
    newest = moments[core.count - 1].time
    if time > newest + SAME:
        steps = max(1, math.ceil((time - newest) / core.longest_step - core.slack))
        core.fresh = core.count
        for k in range(1, steps + 1):
            if core.count == moments.shape[0]:
                core.fresh -= core.count - core.keep
                forget(core, moments, core.count - core.keep)
            core.count += 1
            _empty(moments, readings, core.count - 1, newest + (time - newest) * k / steps)
        moments[core.count - 1].time = time
        _give(core, moments, readings, core.count - 1, first, given)
        return core.count - 1  # type: ignore[no-any-return]
    index = after(moments, core.count, time)
    if index > 0 and moments[index - 1].time >= time - SAME:
        core.fresh = index
        return index - 1 if _give(core, moments, readings, index - 1, first, given) > 0 else -1
    if core.count == moments.shape[0]:
        gone = core.count - core.keep
        forget(core, moments, gone)
        index -= gone
    if index < 1:
        return -1
    row = moments[core.count].row
    for k in range(core.count, index, -1):
        moments[k] = moments[k - 1]
    moments[index].row = row
    core.count += 1
    core.fresh = index
    _empty(moments, readings, index, time)
    _give(core, moments, readings, index, first, given)
    return index


@inner
def after(moments: Records, count: int, time: float) -> int:
    """Index of the first moment later than ``time``."""
    index = count
    while index > 0 and moments[index - 1].time > time + SAME:
        index -= 1
    return index


@inner
def forget(core: Any, moments: Records, gone: int) -> None:
    """Drop the oldest moments; their rows become free."""
    for k in range(core.count - gone):
        row = moments[k].row
        moments[k] = moments[k + gone]
        moments[k + gone].row = row
    core.count -= gone


@inner
def _empty(moments: Records, readings: Records, index: int, time: float) -> None:
    moments[index].time = time
    row = moments[index].row
    for c in range(readings.shape[1]):
        readings[row, c].fate = EMPTY


@inner
def _give(core: Any, moments: Records, readings: Records, index: int, first: int, given: Array) -> int:
    """Write readings where there are none yet; return their number."""
    row, count = moments[index].row, 0
    core.at = index
    for k in range(given.shape[0]):
        reading = readings[row, first + k]
        if reading.fate == EMPTY and math.isfinite(given[k]):
            reading.value, reading.fate, reading.normalised = given[k], GIVEN, math.nan
            count += 1
    return count


# The past inputs, as integrals up to the ends of their intervals, so that a mean is one difference.


@inner
def remember(core: Any, inputs: Array, time: float, applied: Array) -> int:
    """From the last time to this one the inputs were ``applied`` in the mean; how many of them are no numbers, in whose
    place the last one holds.
    """
    last, known, wrong = inputs.shape[0] - 1, numbers_at(core.applied), 0
    for i in range(last):
        for j in range(inputs.shape[1]):
            inputs[i, j] = inputs[i + 1, j]
    for j in range(applied.shape[0]):
        if abs(applied[j]) <= LARGEST_INPUT:
            known[j] = applied[j]
        else:
            wrong += 1
        inputs[last, 1 + j] += (time - inputs[last, 0]) * known[j]
    inputs[last, 0] = time
    return wrong


@inner
def acting(core: Any, inputs: Array, start: float, stop: float, u: Array) -> None:
    """The means of the inputs that act over [start, stop], each its delay after it was given; the last ones hold."""
    delays = numbers_at(core.delays)
    for j in range(u.shape[0]):
        delay = delays[j]
        u[j] = (_integral(inputs, j, stop - delay) - _integral(inputs, j, start - delay)) / (stop - start)


@inner
def _integral(inputs: Array, j: int, time: float) -> float:
    right = inputs.shape[0] - 1
    while right > 1 and inputs[right - 1, 0] > time:  # most questions are about the newest ones
        right -= 1
    begin, end = inputs[right - 1, 0], inputs[right, 0]
    share = (time - begin) / (end - begin)
    return inputs[right - 1, 1 + j] + share * (inputs[right, 1 + j] - inputs[right - 1, 1 + j])  # type: ignore[no-any-return]


@inner
def inputs_to(core: Any, moments: Records, inputs: Array, k: int) -> Array:
    """The inputs (inputs,) that act in the interval before a moment."""
    u, time = vector(core.acting, core.inputs), moments[k].time
    start = moments[k - 1].time if k > 0 else time - core.longest_step
    acting(core, inputs, start, time, u)
    return u


@inner
def count_on(readings: Records, before: int, row: int) -> None:
    """Carry the numbers of consecutive outliers on."""
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
    """Compute beliefs from a moment on, each from the previous one: predict(core, mean, root, u, h) and correct."""
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
            confine(core, root)
        else:  # the initial belief
            for c in range(core.channels):
                if readings[row, c].fate == USED:
                    readings[row, c].fate = INITIALISED
        correct(core, channels, readings[row], mean, mean, root, True)
        clip_state(core, mean)


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
    clip_state(core, mean)
    for c in range(core.channels):
        if readings[row, c].fate != EMPTY:
            readings[row, c].fate = INITIALISED


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
    """The kernel of a filter with a predict(core, mean, root, u, h); see :class:`~.estimator.Estimator`."""
    cores, channels, moments, readings, inputs = memory
    core, changed = cores[0], NOTHING
    if task == MEASURE:
        changed = put(core, moments, readings, inputs, time, since, first, given, applied)
    elif task == BEGIN:
        begin(core, channels, moments, readings, inputs, first)
        changed = 1
    if changed != NOTHING:
        replay(core, channels, moments, readings, inputs, changed, predict)
    return measurement_answer(core, moments, readings, inputs, changed if task == MEASURE else NOTHING, first, out, P)  # type: ignore[no-any-return]


@inner
def measurement_answer(
    core: Any, moments: Records, readings: Records, inputs: Array, changed: int, first: int, out: Array, P: Array
) -> int:
    """What became of a measurement of the channels from ``first`` on. ``out``: states, states ahead, disturbance,
    followed parameters, innovations of the outputs, sum of the normalised squares, each of them by output; ``P``:
    covariance (size, size).
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
        out[shown + k] = out[shown + p + 1 + k] = math.nan
    for c in range(first, p if first < p else first + 1 if changed != NOTHING else 0):
        reading = readings[row, c]
        fine = fine and reading.fate == USED
        if reading.fate == USED or reading.fate == GATED:
            used += 1
            out[shown + p] += reading.normalised
            if c < p:
                out[shown + c], out[shown + p + 1 + c] = reading.innovation, reading.normalised
    if used == 0:
        out[shown + p] = math.nan
    if total != 0.0:
        return LOST
    if changed == NOTHING:
        for k in range(2 * p + 1):
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
