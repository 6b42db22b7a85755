"""Extended Kalman filter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.estimation.augmented import Augmented
from hybrid_sysid_ros.estimation.filter import Filter
from hybrid_sysid_ros.estimation.kernels import Kernels, copy
from hybrid_sysid_ros.estimation.recursive import Belief, recursive

Array = NDArray[np.float64]


class ExtendedKalmanFilter(Filter):
    """The covariance goes through the slopes F of the augmented step; see :class:`~.filter.Filter` for the rest.

        prediction   z+ = mean of f(z, u);  P+ = F P F' + b b' + R_f + Q dt,  b of the input's noise
        correction   K = P H' / S,  S = H P H' + R;  z += K (y - H z)
        Joseph form  P = (I - K H) P (I - K H)' + K R K', which stays symmetric and positive

    The mean, F, b and the remainder R_f are of differences over what is uncertain, not of derivatives, which know
    nothing of friction's corners: see :class:`~.augmented.Augmented`. Source: Sarkka (2013), Bayesian Filtering and
    Smoothing, algorithm 5.4; the Joseph form: Bar-Shalom, Li, Kirubarajan (2001), eq. (5.2.3-18).
    """

    def kernels(self, system: System) -> Kernels:
        return recursive(system, "ekf", covariance_belief)


def covariance_belief(system: System, parts: Augmented) -> Belief:
    """A belief whose root is the covariance itself."""
    linearise = parts.linearise
    states = len(system.states)
    hum_state = states + 1

    @inner
    def predict(core: Any, mean: Array, covariance: Array, drive: float, h: float) -> None:
        linearise(core, mean, covariance, drive, h, core.column, core.jacobian)
        copy(core.column, mean)
        propagate(core, covariance, core.jacobian, h, states)

    @inner
    def observe(core: Any, covariance: Array, row: int, hum: float) -> float:
        column = core.column
        for i in range(column.shape[0]):
            column[i] = covariance[i, row] + hum * covariance[i, hum_state]
        return column[row] + hum * column[hum_state]  # type: ignore[no-any-return]

    @inner
    def condense(core: Any, covariance: Array, row: int, hum: float, variance: float, noise: float) -> None:
        column, rest, size = core.column, core.direction, core.column.shape[0]
        for i in range(size):  # (I - K H) P
            for j in range(size):
                covariance[i, j] -= column[i] / variance * column[j]
        for i in range(size):  # its product with H'
            rest[i] = covariance[i, row] + hum * covariance[i, hum_state]
        for i in range(size):
            for j in range(i + 1):
                gain = column[j] / variance
                value = covariance[i, j] - rest[i] * gain + noise * column[i] / variance * gain
                covariance[i, j] = covariance[j, i] = value

    return Belief(predict=predict, observe=observe, condense=condense, spread=diagonal, covariance=copied)


@inner
def propagate(core: Any, covariance: Array, jacobian: Array, h: float, states: int) -> None:
    """P+ = F P F' + b b' + R_f + Q h in place, symmetric to the last bit; core.push is b, core.remainder R_f."""
    product, size = core.product, covariance.shape[0]
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += jacobian[i, k] * covariance[k, j]
            product[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            total = core.process[i] * h if i == j else 0.0
            if i < states and h > 0.0:
                total += core.remainder[i, j] + core.push[i] * core.push[j]
            for k in range(size):
                total += product[i, k] * jacobian[j, k]
            covariance[i, j] = covariance[j, i] = total


@inner
def diagonal(covariance: Array, variances: Array) -> None:
    """The covariance of independent states."""
    for i in range(variances.shape[0]):
        for j in range(variances.shape[0]):
            covariance[i, j] = variances[i] if i == j else 0.0


@inner
def copied(covariance: Array, out: Array) -> None:
    """The covariance is its own root."""
    for i in range(covariance.shape[0]):
        copy(covariance[i], out[i])
