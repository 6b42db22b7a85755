"""Unscented Kalman filter in square-root form."""

from __future__ import annotations

import math
from typing import Any

from hybrid_sysid_ros.core.addresses import matrix, numbers_at, vector
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.estimation.belief import add_process_noise, copy, move, rest
from hybrid_sysid_ros.estimation.estimator import Estimator
from hybrid_sysid_ros.estimation.extended_kalman_filter import triangle
from hybrid_sysid_ros.estimation.measurement_sequence import filtered
from hybrid_sysid_ros.support.arrays import Array

CENTRE_WEIGHT = 2.0
"""Weight of the middle point in the covariance: 1 - alpha^2 + beta with alpha = 1, kappa = 0 and beta = 2."""


@inner
def predict(core: Any, mean: Array, root: Array, drive: Array, h: float) -> None:
    """One step of a belief, in place."""
    m, size = core.inputs, mean.shape[0]
    count = size + m  # the inputs' noise has dimensions of its own, since friction acts on it
    points = matrix(core.rows, 3 * size + 2 * m + 1, size)
    z, middle, pushed = vector(core.point, size), vector(core.centre, size), vector(core.pushed, m)
    spread, weight, noise = math.sqrt(1.0 * count), 1.0 / math.sqrt(2.0 * count), numbers_at(core.input_noise)
    for i in range(2 * count):
        sign, k = (spread, i // 2) if i % 2 else (-spread, i // 2)
        for j in range(size):
            z[j] = mean[j] + (sign * root[j, k] if k < size else 0.0)
        for j in range(m):
            pushed[j] = drive[j] + (sign * noise[j] / math.sqrt(h) if k == size + j else 0.0)
        move(core, z, pushed, h, points[i])
        rest(core, z, h, points[i])
    move(core, mean, drive, h, middle)
    copy(mean, z)
    rest(core, z, h, middle)
    for j in range(size):
        total = 0.0
        for i in range(2 * count):
            total += points[i, j]
        mean[j] = total / (2 * count)
        for i in range(2 * count):
            points[i, j] = weight * (points[i, j] - mean[j])
        points[2 * count, j] = math.sqrt(CENTRE_WEIGHT) * (middle[j] - mean[j])
    triangle(points, add_process_noise(core, points, 2 * count + 1, h), root)


@kernel
def _run(
    memory: Any, task: int, time: float, since: float, first: int, given: Array, applied: Array, out: Array, P: Array
) -> int:
    return filtered(memory, task, time, since, first, given, applied, out, P, predict)  # type: ignore[no-any-return]


class UnscentedKalmanFilter(Estimator):
    """Predicts a root S of the covariance, P = S S', by the exact step; see :class:`~.estimator.Estimator`.

        sigma points  z_0 = z,  z_i = z +- sqrt(L) S_i,  and u +- sqrt(L U / dt),  L = size of z and u
        prediction    z+ = sum f(z_i, u) / 2 L  over i > 0
                      S+' = triangle of [(f(z_i, u) - z+) / sqrt(2 L); sqrt(2) (f(z_0, u) - z+); sqrt(Q dt)]
        correction    that of the extended filter, over the same points where an output is a map

    All weights are positive, so a root is never reduced below zero. Source: van der Merwe & Wan (2001), ICASSP 6,
    algorithm 3.1, with alpha = 1, kappa = 0.
    """

    _run = staticmethod(_run)
