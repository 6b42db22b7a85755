"""Moments of time, in order, where readings are put in whatever order they come; and the past inputs. Compiled."""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.memory import EMPTY, GIVEN, SAME, numbers
from hybrid_sysid_ros.support.arrays import Array, Records


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
    """Drop the oldest moments; their rows go to the others."""
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
    """Write readings where there are none yet; how many."""
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
    last, known, wrong = inputs.shape[0] - 1, numbers(core.applied), 0
    for i in range(last):
        for j in range(inputs.shape[1]):
            inputs[i, j] = inputs[i + 1, j]
    for j in range(applied.shape[0]):
        if math.isfinite(applied[j]):
            known[j] = applied[j]
        else:
            wrong += 1
        inputs[last, 1 + j] += (time - inputs[last, 0]) * known[j]
    inputs[last, 0] = time
    return wrong


@inner
def acting(core: Any, inputs: Array, start: float, stop: float, u: Array) -> None:
    """The means of the inputs that act over [start, stop], each its delay after it was given; the last ones hold."""
    delays = numbers(core.delays)
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
