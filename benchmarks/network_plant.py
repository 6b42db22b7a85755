"""A plant whose motion is mostly a network: the reference problem of fast neural MPC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Equation, Operations, Step, Variable
from hybrid_sysid_ros.core.perceptron import Perceptron

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
class NetworkPlant(Equation):
    """x1' = x2,  x2' = 30 u - 8 x2 - 2 x1 + 5 NN(x1, x2 / 10, u / 10), by the classical Runge-Kutta method."""

    states: ClassVar[tuple[Variable, ...]] = (Variable(name="x1", unit="1"), Variable(name="x2", unit="1/s"))
    inputs: ClassVar[tuple[Variable, ...]] = (Variable(name="u", unit="1"),)

    @property
    def weights(self) -> NDArray[np.float64]:
        return WEIGHTS

    def advance(self, operations: Operations) -> Step:
        network = operations.perceptron(NETWORK)

        def rate(x1: Any, x2: Any, u: Any, w: Any) -> Any:
            return 30.0 * u - 8.0 * x2 - 2.0 * x1 + 5.0 * network((x1, x2 * 0.1, u * 0.1), w)

        rate = operations.function(rate)

        def step(x: Any, u: Any, p: Any, w: Any, h: Any, following: Any) -> None:
            x1, v1 = x[0], x[1]
            a1 = rate(x1, v1, u[0], w)
            v2 = v1 + 0.5 * h * a1
            a2 = rate(x1 + 0.5 * h * v1, v2, u[0], w)
            v3 = v1 + 0.5 * h * a2
            a3 = rate(x1 + 0.5 * h * v2, v3, u[0], w)
            v4 = v1 + h * a3
            a4 = rate(x1 + h * v3, v4, u[0], w)
            following[0] = x1 + h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            following[1] = v1 + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

        return step
