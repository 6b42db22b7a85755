"""Unscented Kalman filter in square-root form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.augmented import Augmented
from hybrid_sysid_ros.estimation.filter import Filter
from hybrid_sysid_ros.estimation.kernels import Kernels
from hybrid_sysid_ros.estimation.recursive import Belief, recursive

Array = NDArray[np.float64]

CENTRE_WEIGHT = 2.0
"""Of the middle point in the covariance: 1 - alpha^2 + beta with the scaling alpha = 1, kappa = 0 and beta = 2."""


class UnscentedKalmanFilter(Filter):
    """A root S of the covariance, P = S S', goes through the exact step; see :class:`~.filter.Filter` for the rest.

        sigma points  z_0 = z,  z_i = z +- sqrt(L) S_i,  and u +- sqrt(L U / dt),  L = 1 + size of z
        prediction    z+ = sum f(z_i, u) / 2 L  over i > 0
                      S+' = triangle of [(f(z_i, u) - z+) / sqrt(2 L); sqrt(2) (f(z_0, u) - z+); sqrt(Q dt)]
        correction    K = P H' / V,  V = H P H' + R;  z += K (y - H z);  S (I - g a a' / V),  a = S' H'
                      with g = 1 / (1 + sqrt(R / V))

    All weights are positive, so no root is ever taken down below zero. Source: van der
    Merwe & Wan (2001), ICASSP 6, algorithm 3.1, with alpha = 1, kappa = 0; as a measurement is linear, its square-root
    correction is exact, and Potter's: Kaminski, Bryson, Schmidt (1971), IEEE TAC 16(6), eq. (19).
    """

    def kernels(self, system: System) -> Kernels:
        return recursive(system, "ukf", square_root_belief)


def square_root_belief(system: System, parts: Augmented) -> Belief:
    """A belief whose root is a square root of the covariance."""
    move = parts.move
    hum_state = len(system.states) + 1

    @inner
    def predict(core: Any, mean: Array, root: Array, drive: float, h: float) -> None:
        points, z, middle, size = core.points, core.column, core.direction, core.column.shape[0]
        count = size + 1  # the input's noise is a dimension of its own, as it goes through the friction
        spread, weight = math.sqrt(count), 1.0 / math.sqrt(2.0 * count)
        for i in range(2 * count):
            sign, k = (spread, i // 2) if i % 2 else (-spread, i // 2)
            for j in range(size):
                z[j] = mean[j] + (sign * root[j, k] if k < size else 0.0)
            force = sign * math.sqrt(core.input_noise / h) if k == size else 0.0
            move(core, z, drive + force, h, points[i])
        move(core, mean, drive, h, middle)
        for j in range(size):
            total = 0.0
            for i in range(2 * count):
                total += points[i, j]
            mean[j] = total / (2 * count)
            for i in range(2 * count):
                points[i, j] = weight * (points[i, j] - mean[j])
            points[2 * count, j] = math.sqrt(CENTRE_WEIGHT) * (middle[j] - mean[j])
            for i in range(size):
                points[2 * count + 1 + i, j] = math.sqrt(core.process[j] * h) if i == j else 0.0
        triangle(points, root)

    @inner
    def observe(core: Any, root: Array, row: int, hum: float) -> float:
        column, direction, size = core.column, core.direction, core.column.shape[0]
        variance = 0.0
        for j in range(size):
            direction[j] = root[row, j] + hum * root[hum_state, j]
            variance += direction[j] * direction[j]
        for i in range(size):
            total = 0.0
            for j in range(size):
                total += root[i, j] * direction[j]
            column[i] = total
        return variance

    @inner
    def condense(core: Any, root: Array, row: int, hum: float, variance: float, noise: float) -> None:
        column, direction = core.column, core.direction
        factor = 1.0 / (variance * (1.0 + math.sqrt(noise / variance)))
        for i in range(column.shape[0]):
            for j in range(column.shape[0]):
                root[i, j] -= factor * column[i] * direction[j]

    return Belief(predict=predict, observe=observe, condense=condense, spread=diagonal_root, covariance=squared)


@inner
def triangle(rows: Array, root: Array) -> None:
    """Lower triangle S with S S' = A' A of the rows A (rows, size), by Householder's reflections; A is destroyed."""
    count, size = rows.shape
    for j in range(size):
        norm = 0.0
        for i in range(j, count):
            norm += rows[i, j] * rows[i, j]
        norm = math.sqrt(norm)
        if norm > 0.0:
            if rows[j, j] > 0.0:
                norm = -norm
            rows[j, j] -= norm
            scale = -1.0 / (norm * rows[j, j])
            for k in range(j + 1, size):
                total = 0.0
                for i in range(j, count):
                    total += rows[i, j] * rows[i, k]
                for i in range(j, count):
                    rows[i, k] -= scale * total * rows[i, j]
        root[j, j] = norm
        for k in range(j + 1, size):
            root[k, j], root[j, k] = rows[j, k], 0.0


@inner
def diagonal_root(root: Array, variances: Array) -> None:
    """The root of the covariance of independent states."""
    for i in range(variances.shape[0]):
        for j in range(variances.shape[0]):
            root[i, j] = math.sqrt(variances[i]) if i == j else 0.0


@inner
def squared(root: Array, out: Array) -> None:
    """P = S S'."""
    size = root.shape[0]
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(size):
                total += root[i, k] * root[j, k]
            out[i, j] = out[j, i] = total
