"""Moving-horizon estimation by Gauss-Newton."""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.addresses import matrix, vector
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.estimation.belief import (
    clip_state,
    copy,
    copy_matrix,
    correct,
    mean_of,
    move,
    rest,
    root_of,
    solve_triangular,
)
from hybrid_sysid_ros.estimation.estimator import Estimator
from hybrid_sysid_ros.estimation.extended_kalman_filter import differences, triangle
from hybrid_sysid_ros.estimation.measurement_sequence import (
    BEGIN,
    MEASURE,
    NOTHING,
    SAME,
    after,
    begin,
    count_on,
    inputs_to,
    measurement_answer,
    put,
)
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array, Records

ITERATIONS = 2
"""Gauss-Newton steps for each measurement; they begin at the last window, and a third step changes nothing."""


@inner
def _predicted(core: Any, row: int) -> Array:
    return vector(core.predicted, core.size, row * core.size)


@inner
def _filtered(core: Any, row: int) -> Array:
    return vector(core.filtered, core.size, row * core.size)


@inner
def _predicted_root(core: Any, row: int) -> Array:
    return matrix(core.predicted_roots, core.size, core.size, row * core.size * core.size)


@inner
def _transition(core: Any, row: int) -> Array:
    """First differences of the step to a moment over the previous filtered root; its column i is in row i."""
    return matrix(core.transitions, core.size, core.size, row * core.size * core.size)


@inner
def _solve(core: Any, channels: Records, moments: Records, readings: Records, inputs: Array, first: int) -> None:
    """Gauss-Newton over the moments from ``first`` on; their means are its initial values and its result."""
    for iteration in range(ITERATIONS):
        _forward(core, channels, moments, readings, inputs, first, iteration == 0)
        _backward(core, moments, first)


@inner
def _forward(
    core: Any, channels: Records, moments: Records, readings: Records, inputs: Array, first: int, judge: bool
) -> None:
    """A Kalman filter over the problem linearised around the trajectory, from the first moment's prior on."""
    size = core.size
    rows, away = matrix(core.rows, 3 * size + 2 * core.inputs + 1, size), vector(core.gain, size)
    for k in range(first, core.count):
        row = moments[k].row
        predicted, predicted_root = _predicted(core, row), _predicted_root(core, row)
        u = inputs_to(core, moments, inputs, k)
        if k > first:
            before = moments[k - 1].row
            at, root, transition = mean_of(core, before), root_of(core, before), _transition(core, row)
            h = moments[k].time - moments[k - 1].time
            count = differences(core, at, root, u, h, predicted, rows)
            copy_matrix(rows[:size], transition)
            triangle(rows, count, predicted_root)
            filtered = _filtered(core, before)
            for i in range(size):
                away[i] = filtered[i] - at[i]
            solve_triangular(root, away)
            for i in range(size):
                for j in range(size):
                    predicted[j] += transition[i, j] * away[i]
            if judge:
                count_on(readings, before, row)
        copy(predicted, _filtered(core, row))
        copy_matrix(predicted_root, root_of(core, row))
        mean, filtered, root = mean_of(core, row), _filtered(core, row), root_of(core, row)
        correct(core, channels, readings[row], mean, filtered, root, judge and k > first)


@inner
def _backward(core: Any, moments: Records, first: int) -> None:
    """The smoother's means: s_k = z_k + S_k A' M^-1 (s_k+1 - m).

    z_k, S_k: filtered; m, M: predicted; A: the transition over S_k.
    """
    size, last = core.size, core.count - 1
    pulled = vector(core.gain, size)
    copy(_filtered(core, moments[last].row), mean_of(core, moments[last].row))
    for k in range(last - 1, first - 1, -1):
        row, following = moments[k].row, moments[k + 1].row
        after_mean, predicted = mean_of(core, following), _predicted(core, following)
        predicted_root, transition = _predicted_root(core, following), _transition(core, following)
        mean, filtered, root = mean_of(core, row), _filtered(core, row), root_of(core, row)
        for i in range(size):
            pulled[i] = after_mean[i] - predicted[i]
        solve_triangular(predicted_root, pulled)
        solve_transposed(predicted_root, pulled)
        copy(filtered, mean)
        for i in range(size):
            share = 0.0
            for j in range(size):
                share += transition[i, j] * pulled[j]
            for j in range(i, size):
                mean[j] += root[j, i] * share
    for k in range(first, core.count):
        clip_state(core, mean_of(core, moments[k].row))


@inner
def solve_transposed(root: Array, x: Array) -> None:
    """S'^-1 x in place, S lower triangular; entries without variance become zero."""
    for i in range(x.shape[0] - 1, -1, -1):
        for k in range(i + 1, x.shape[0]):
            x[i] -= root[k, i] * x[k]
        x[i] = x[i] / root[i, i] if root[i, i] != 0.0 else 0.0


@inner
def _guess(core: Any, moments: Records, inputs: Array, first: int, last: int) -> None:
    """The initial trajectory of new moments, which is the model's prediction."""
    for k in range(max(first, 1), last + 1):
        before, mean = mean_of(core, moments[k - 1].row), mean_of(core, moments[k].row)
        h = moments[k].time - moments[k - 1].time
        move(core, before, inputs_to(core, moments, inputs, k), h, mean)
        rest(core, before, h, mean)


@kernel
def _run(
    memory: Any, task: int, time: float, since: float, first: int, given: Array, applied: Array, out: Array, P: Array
) -> int:
    cores, channels, moments, readings, inputs = memory
    core, changed, oldest = cores[0], NOTHING, -math.inf
    if task == MEASURE:
        horizon = after(moments, core.count, moments[core.count - 1].time - core.span - 2.0 * SAME)
        oldest = moments[horizon].time
        changed = put(core, moments, readings, inputs, time, since, first, given, applied)
    elif task == BEGIN:
        begin(core, channels, moments, readings, inputs, first)
        row = moments[0].row
        copy(mean_of(core, row), _predicted(core, row))
        copy_matrix(root_of(core, row), _predicted_root(core, row))
        changed, core.fresh, core.at = 1, 1, core.count - 1
    if changed != NOTHING:
        _guess(core, moments, inputs, core.fresh, core.at)
        _solve(core, channels, moments, readings, inputs, after(moments, core.count, oldest - 2.0 * SAME))
    return measurement_answer(core, moments, readings, inputs, changed if task == MEASURE else NOTHING, first, out, P)  # type: ignore[no-any-return]


class MovingHorizonEstimator(Estimator):
    """Minimises the cost of a trajectory z_0 ... z_N over the last measurements.

        |z_0 - prior|^2_P0 + sum |z_k+1 - f(z_k, u_k)|^2_(Q dt) + sum |y_k - h(z_k)|^2_R,   |e|^2_M = e' M^-1 e

    See :class:`~.estimator.Estimator` for the rest. Each Gauss-Newton step is one pass of a Kalman filter forwards and
    one of a smoother backwards over the problem linearised around the trajectory, so it costs as much as N updates.
    Full steps are taken without a line search, which the corners of the cost would stall. The arrival cost (prior, P0)
    of a moment is the filter's prediction there, from measurements that have left the window. A measurement out of
    order is inserted at its time within the window.

    Source: Rao, Rawlings, Mayne (2003), IEEE TAC 48(2), with the filtering update of the arrival cost; the passes: Bell
    (1994), SIAM J. Optim. 4(3), and Rauch, Tung, Striebel (1965).
    """

    windowed = True
    _run = staticmethod(_run)

    def _window_of(self, tuning: Tuning, period: float) -> float:
        return tuning.horizon * period
