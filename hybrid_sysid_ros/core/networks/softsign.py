"""One hidden layer of softsigns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.blocks import Block, Kernels
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, absolute
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Softsign(Block):
    """y_k = sum_i a_ki softsign(W_i z + b_i): one hidden layer, bounded by sum |a|, without transcendental functions.

    The weights of each unit are W_i (features,), b_i and a_i (outputs,).
    """

    features: int
    units: int
    outputs: int = 1
    at: int = 0

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.units * (self.features + 1 + self.outputs)

    def initial(self, seed: int, *, output: float = 0.0) -> Array:
        """Random hidden weights; output weights normal with deviation ``output``. Shape (size,)."""
        random = np.random.default_rng(seed)
        weights = random.normal(size=(self.units, self.features + 1 + self.outputs))
        weights[:, self.features] *= 0.5
        weights[:, self.features + 1 :] *= output
        return weights.ravel()

    @property
    def kernels(self) -> Kernels:
        units, features, outputs = self.units, self.features, self.outputs
        width = features + 1 + outputs

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            for k in range(outputs):
                y[k] = 0.0
            for i in range(units):
                s = activation(w, at + width * i, z, features)
                t = s / (1.0 + abs(s))
                for k in range(outputs):
                    y[k] += w[at + width * i + features + 1 + k] * t

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            for k in range(outputs):
                y[k] = 0.0
                for j in range(features):
                    by_z[k * features + j] = 0.0
            for i in range(units):
                s = activation(w, at + width * i, z, features)
                slope = 1.0 / (1.0 + abs(s))
                t = s * slope
                slope *= slope
                for k in range(outputs):
                    a = w[at + width * i + features + 1 + k]
                    y[k] += a * t
                    for j in range(features):
                        by_z[k * features + j] += a * slope * w[at + width * i + j]

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            for i in range(units):
                s = activation(w, at + width * i, z, features)
                slope = 1.0 / (1.0 + abs(s))
                t = s * slope
                total = 0.0
                for k in range(outputs):
                    total += factors[k] * w[at + width * i + features + 1 + k]
                    row[start + width * i + features + 1 + k] += factors[k] * t
                total *= slope * slope
                row[start + width * i + features] += total
                for j in range(features):
                    row[start + width * i + j] += total * z[j]

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        width = self.features + 1 + self.outputs
        y: list[Scalar] = [0.0] * self.outputs
        for i in range(self.units):
            of = w[width * i : width * (i + 1)]
            s = sum((a * value for a, value in zip(of, z, strict=False)), of[self.features])
            t = s / (1.0 + absolute(s))
            y = [total + a * t for total, a in zip(y, of[self.features + 1 :], strict=True)]
        return y


@inner
def activation(w: Any, at: int, z: Any, features: int) -> float:
    """Return W z + b of the unit whose weights begin at index ``at``."""
    s = w[at + features]
    for j in range(features):
        s += w[at + j] * z[j]
    return s
