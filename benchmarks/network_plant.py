"""A plant whose motion is mostly a network: the reference problem of fast neural MPC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.perceptron import Perceptron
from hybrid_sysid_ros.core import RungeKutta, System
from hybrid_sysid_ros.core.mathematics import Scalar

NETWORK = Perceptron(widths=(3, 32, 32, 1))


def layers() -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """W1, b1, W2, W3 drawn in this order from default_rng(0); the other biases are zero."""
    random = np.random.default_rng(0)
    first = random.normal(size=(32, 3)) * 0.5
    bias = random.normal(size=32) * 0.1
    second = random.normal(size=(32, 32)) / np.sqrt(32) * 0.8
    third = random.normal(size=(1, 32)) * 0.3
    return [(first, bias), (second, np.zeros(32)), (third, np.zeros(1))]


WEIGHTS = NETWORK.packed(layers())


@dataclass(frozen=True, kw_only=True)
class NetworkPlant(System):
    """x1' = x2,  x2' = 30 u - 8 x2 - 2 x1 + 5 NN(x1, x2 / 10, u / 10), by the classical Runge-Kutta method."""

    states = ("x1 [1]", "x2 [1/s]")
    inputs = ("u [1]",)
    stepper = RungeKutta()

    @property
    def weights(self) -> NDArray[np.float64]:
        return WEIGHTS

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        network = NETWORK([x[0], x[1] * 0.1, u[0] * 0.1])[0]
        return x[1], 30.0 * u[0] - 8.0 * x[1] - 2.0 * x[0] + 5.0 * network
