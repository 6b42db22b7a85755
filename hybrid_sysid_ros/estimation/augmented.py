"""The model with what else is unknown beside it, compiled: one step of z = [x, d, hums, theta], and what outputs show.

    x+ = step(x, u + d + w; theta),  d+ = d,  (s, c)+ = rotation(2 pi f h) (s, c),  theta+ = theta
    y  = h(x, u + d; theta) + s

x: the model's states, d: an offset of each input and w its white noise, s: the hum of an output with its quadrature c,
theta: the followed parameters. Everything but x moves by itself; the process noise makes it drift.
"""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.memory import EMPTY, matrix, numbers, vector
from hybrid_sysid_ros.estimation.square_root import solve, triangle
from hybrid_sysid_ros.support.arrays import Array, Records

REACH = math.sqrt(6.0)
"""Of differences, in deviations: it sees the break-away of a joint that sticks, which sqrt(3), the best where all is
smooth, often misses."""


@inner
def copy(source: Array, target: Array) -> None:
    """Compiled in no time, as an assignment of slices is not."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@inner
def copy_matrix(source: Array, target: Array) -> None:
    """The same of matrices."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@inner
def clip(core: Any, mean: Array) -> None:
    """Hold a state within its bounds."""
    low, high = numbers(core.low), numbers(core.high)
    for i in range(core.states, mean.shape[0]):
        mean[i] = min(max(mean[i], low[i]), high[i])


@inner
def _with(core: Any, z: Array, drive: Array) -> None:
    """Set the model's inputs and parameters to those of z."""
    n, m, size = core.states, core.inputs, z.shape[0]
    u = numbers(core.drive)
    for j in range(m):
        u[j] = drive[j] + z[n + j]
    if core.followed:
        parameters, which = numbers(core.parameters), numbers(core.followed_index)
        low, high, first = numbers(core.low), numbers(core.high), size - core.followed
        for i in range(first, size):
            parameters[int(which[i - first])] = min(max(z[i], low[i]), high[i])


@inner
def move(core: Any, z: Array, drive: Array, h: float, following: Array) -> None:
    """One step of h [s] of the model under the inputs ``drive`` (inputs,): ``following`` receives its states."""
    _with(core, z, drive)
    parameters, weights, u = numbers(core.parameters), numbers(core.weights), numbers(core.drive)
    call_value(core.step, z, u, parameters, weights, h, 0.0, following)


@inner
def rest(core: Any, z: Array, h: float, following: Array) -> None:
    """The same step of what moves by itself."""
    first, size = core.states, z.shape[0]
    for i in range(first, size):
        following[i] = z[i]
    turning, at = numbers(core.turning), first + core.inputs
    for k in range(core.hums):
        angle = turning[k] * h
        cosine, sine = math.cos(angle), math.sin(angle)
        following[at] = cosine * z[at] + sine * z[at + 1]
        following[at + 1] = cosine * z[at + 1] - sine * z[at]
        at += 2


@inner
def add_process_noise(core: Any, rows: Array, count: int, h: float) -> int:
    """Append the rows of the root of Q h; returns the new count."""
    process, size = numbers(core.process), rows.shape[1]
    for i in range(size):
        if process[i] > 0.0:
            for j in range(size):
                rows[count, j] = 0.0
            rows[count, i] = math.sqrt(process[i] * h)
            count += 1
    return count


@inner
def differences(core: Any, at: Array, root: Array, drive: Array, h: float, following: Array, rows: Array) -> int:
    """One step of all that lies about ``at`` as ``root`` says, by second-order divided differences.

    Dry friction has corners that are narrower than what is uncertain: a derivative sees the rig stick or slip, a
    difference what lies between. So the step f is seen over the columns s of the root,

        slope = (f(z + r s) - f(z - r s)) / 2 r,  bend = (f(z + r s) - 2 f(z) + f(z - r s)) / r^2
        mean = f(z) + sum bend / 2,  covariance = sum slope slope' + sum bend bend' / 2

    with the reach r, where a normal e has E e^2 = 1 and var e^2 = 2. Source: Norgaard, Poulsen, Ravn (2000), Automatica
    36(11).

    ``following`` (size,) receives the mean, the first ``size`` of ``rows`` the slopes, the others the bends and what
    the inputs' noise adds, the last ones process noise; returns how many there are. ``root`` becomes triangular.
    """
    n, m, size = core.states, core.inputs, at.shape[0]
    above, below = vector(core.above, size), vector(core.below, size)
    point, centre, pushed = vector(core.point, size), vector(core.centre, size), vector(core.pushed, m)
    noise = numbers(core.input_noise)
    for i in range(size):
        for j in range(size):
            rows[i, j] = root[j, i]
    triangle(rows, size, root)
    move(core, at, drive, h, centre)
    copy(centre, following)
    rest(core, at, h, following)
    count = size
    for i in range(size + m):
        row = i if i < size else count
        for j in range(size):
            point[j] = root[j, i] if i < size and j >= i else 0.0
            rows[row, j] = 0.0
        if i < size:
            if root[i, i] == 0.0:
                continue
            rest(core, point, h, rows[row])
            if n + m <= i and core.followed == 0:
                continue  # a hum moves nothing else
            for j in range(size):
                below[j] = at[j] - REACH * point[j]
                point[j] = at[j] + REACH * point[j]
            move(core, point, drive, h, above)
            copy(below, point)
            move(core, point, drive, h, below)
        else:
            push = REACH * noise[i - size] / math.sqrt(h)
            if push == 0.0:
                continue
            count += 1
            copy(drive, pushed)
            pushed[i - size] = drive[i - size] + push
            move(core, at, pushed, h, above)
            pushed[i - size] = drive[i - size] - push
            move(core, at, pushed, h, below)
        bends = 0.0
        for j in range(n):
            rows[row, j] = (above[j] - below[j]) / (2.0 * REACH)
            bend = (above[j] + below[j] - 2.0 * centre[j]) / (REACH * REACH)
            following[j] += 0.5 * bend
            rows[count, j] = math.sqrt(0.5) * bend
            bends += bend * bend
        if bends > 0.0:
            for j in range(n, size):
                rows[count, j] = 0.0
            count += 1
    return add_process_noise(core, rows, count, h)


@inner
def _show(core: Any, z: Array, shown: Array) -> None:
    """The output map at z."""
    _with(core, z, vector(core.acting, core.inputs))
    parameters, weights, u = numbers(core.parameters), numbers(core.weights), numbers(core.drive)
    call_value(core.output, z, u, parameters, weights, core.longest_step, 0.0, shown)


@inner
def _map_outputs(core: Any, at: Array, root: Array) -> None:
    """The output map over the columns of the root, as in :func:`differences`: core.shown has its mean (outputs,) and
    then the variance of its bends (outputs,), core.by_output (outputs, size) the slopes.
    """
    p, size = core.outputs, at.shape[0]
    shown, above, below = vector(core.shown, 2 * p), vector(core.above_shown, 2 * p), vector(core.below_shown, 2 * p)
    point, slopes = vector(core.point, size), matrix(core.by_output, p, size)
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
            slopes[k, i] = (above[k] - below[k]) / (2.0 * REACH)
            bend = (above[k] + below[k] - 2.0 * below[p + k]) / (REACH * REACH)
            shown[k] += 0.5 * bend
            shown[p + k] += 0.5 * bend * bend


@inner
def expect(core: Any, channels: Records, readings: Records, at: Array, mean: Array, root: Array) -> None:
    """What the channels that have a reading should show: core.expected and core.variance (channels,) of their noise,
    core.sensitivity (channels, size) by the columns of the root. ``at`` is where a map is seen, ``mean`` is expected.
    """
    size, count = at.shape[0], core.channels
    expected, variance, sensitivity = (
        numbers(core.expected),
        numbers(core.variance),
        matrix(core.sensitivity, count, size),
    )
    shown, by_output = numbers(core.shown), matrix(core.by_output, core.outputs, size)
    mapped = False
    for c in range(count):
        mapped = mapped or (readings[c].fate != EMPTY and channels[c].state < 0)
    if mapped:
        away = vector(core.z, size)
        for i in range(size):
            away[i] = mean[i] - at[i]
        if core.windowed:
            solve(root, away)
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
