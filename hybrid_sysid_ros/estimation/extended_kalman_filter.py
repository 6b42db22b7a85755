"""Extended Kalman filter, of second order, in square-root form."""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.addresses import matrix, numbers_at, vector
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.estimation.belief import REACH, add_process_noise, copy, move, rest
from hybrid_sysid_ros.estimation.estimator import Estimator
from hybrid_sysid_ros.estimation.measurement_sequence import filtered
from hybrid_sysid_ros.support.arrays import Array

NO_VARIANCE = 1e-7
"""Share of a deviation that counts as zero, where earlier entries explain the rest."""


@inner
def differences(core: Any, at: Array, root: Array, drive: Array, h: float, following: Array, rows: Array) -> int:
    """One step of the distribution around ``at`` with the root ``root``, by second-order divided differences.

    Dry friction has corners that are narrower than the uncertainty: a derivative sees the rig either stick or slip, a
    difference averages over both. So the step f is evaluated over the columns s of the root,

        d1 = (f(z + r s) - f(z - r s)) / 2 r,  d2 = (f(z + r s) - 2 f(z) + f(z - r s)) / r^2
        mean = f(z) + sum d2 / 2,  covariance = sum d1 d1' + sum d2 d2' / 2

    with the reach r, where a normal e has E e^2 = 1 and var e^2 = 2. Source: Norgaard, Poulsen, Ravn (2000), Automatica
    36(11).

    ``following`` (size,) receives the mean, the first ``size`` of ``rows`` the d1, the next ones the d2 and the inputs'
    noise, the last ones the process noise; the number of rows is returned. ``root`` becomes triangular.
    """
    n, m, size = core.states, core.inputs, at.shape[0]
    above, below = vector(core.above, size), vector(core.below, size)
    point, centre, pushed = vector(core.point, size), vector(core.centre, size), vector(core.pushed, m)
    noise = numbers_at(core.input_noise)
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
        bending = 0.0
        for j in range(n):
            rows[row, j] = (above[j] - below[j]) / (2.0 * REACH)
            second = (above[j] + below[j] - 2.0 * centre[j]) / (REACH * REACH)
            following[j] += 0.5 * second
            rows[count, j] = math.sqrt(0.5) * second
            bending += second * second
        if bending > 0.0:
            for j in range(n, size):
                rows[count, j] = 0.0
            count += 1
    return add_process_noise(core, rows, count, h)


@inner
def triangle(rows: Array, count: int, root: Array) -> None:
    """Lower triangular S (size, size) with S S' = A' A of the first ``count`` rows A (rows, size), which are destroyed.

    Householder's reflections: Golub, Van Loan (2013), Matrix Computations, algorithm 5.2.1. An entry without variance
    beyond that of earlier ones has a column of zeros.
    """
    size, row = root.shape[0], 0
    a, s = pointer(rows), pointer(root)  # plain memory, whose loops are fast
    for j in range(size):
        norm, earlier = 0.0, 0.0
        for i in range(row, count):
            norm += a[i * size + j] * a[i * size + j]
        for i in range(j):
            earlier += s[j * size + i] * s[j * size + i]
            s[i * size + j] = 0.0
        if norm <= NO_VARIANCE * NO_VARIANCE * earlier:
            for k in range(j, size):
                s[k * size + j] = 0.0
            continue
        norm = math.sqrt(norm)
        if a[row * size + j] > 0.0:
            norm = -norm
        a[row * size + j] -= norm
        scale = -1.0 / (norm * a[row * size + j])
        s[j * size + j] = norm
        for k in range(j + 1, size):
            total = 0.0
            for i in range(row, count):
                total += a[i * size + j] * a[i * size + k]
            total *= scale
            for i in range(row, count):
                a[i * size + k] -= total * a[i * size + j]
            s[k * size + j] = a[row * size + k]
        row += 1


@inner
def predict(core: Any, mean: Array, root: Array, drive: Array, h: float) -> None:
    """One step of a belief, in place."""
    size = mean.shape[0]
    rows, following = matrix(core.rows, 3 * size + 2 * core.inputs + 1, size), vector(core.gain, size)
    count = differences(core, mean, root, drive, h, following, rows)
    copy(following, mean)
    triangle(rows, count, root)


@kernel
def _run(
    memory: Any, task: int, time: float, since: float, first: int, given: Array, applied: Array, out: Array, P: Array
) -> int:
    return filtered(memory, task, time, since, first, given, applied, out, P, predict)  # type: ignore[no-any-return]


class ExtendedKalmanFilter(Estimator):
    """Predicts the root S of the covariance, P = S S', by differences of the step; see :class:`~.estimator.Estimator`.

        prediction   z+ = mean of f(z, u),  S+' = triangle of [d1 over S and the inputs' noise; d2; sqrt(Q dt)]
        correction   V = H P H' + R,  z += P H' (y - h(z)) / V,  S (I - g a a'),  a = S' H'

    The differences d1 and d2 over the uncertainty replace derivatives, which miss the corners of friction: see
    :func:`differences`, by Norgaard, Poulsen, Ravn (2000), Automatica 36(11).
    """

    _run = staticmethod(_run)
