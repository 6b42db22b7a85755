"""An affine map with a hidden layer beside it, as a block of a law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.blocks import Block, Kernels, weighed
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, clip, tanh
from hybrid_sysid_ros.core.networks.softsign import activation

REACH = 3.0
"""The argument of a power is limited to so many times its largest magnitude in training data, which is 1."""


@dataclass(frozen=True, kw_only=True)
class AffineMap(Block):
    """y = M z + m + sum_i V_i f(P_i z + q_i), where f(s) is tanh s, or s^power with s limited to +-REACH.

    Weights: rows of (M, m) for each output, then P_i (features,), q_i and V_i (outputs,) for each unit.
    """

    features: int
    outputs: int
    units: int = 0
    power: int = 0
    """0: the hidden layer is of tanh."""
    at: int = 0

    @property
    def size(self) -> int:  # type: ignore[override]
        return (self.outputs + self.units) * (self.features + 1) + self.units * self.outputs

    @property
    def kernels(self) -> Kernels:
        features, outputs, units, power = self.features, self.outputs, self.units, self.power

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            mapped(w, at, z, features, outputs, units, power, y)

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            mapped(w, at, z, features, outputs, units, power, y)
            differentiated(w, at, z, features, outputs, units, power, by_z)

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            wide, place = features + 1, start
            for k in range(outputs):
                for j in range(features):
                    row[place + j] += factors[k] * z[j]
                row[place + features] += factors[k]
                place += wide
            unit = at + outputs * wide
            for _ in range(units):
                s = activation(w, unit, z, features)
                total = 0.0
                for k in range(outputs):
                    total += factors[k] * w[unit + wide + k]
                    row[place + wide + k] += factors[k] * curve(s, power)
                total *= slope(s, power)
                for j in range(features):
                    row[place + j] += total * z[j]
                row[place + features] += total
                unit += wide + outputs
                place += wide + outputs

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        wide, unit = self.features + 1, self.outputs * (self.features + 1)
        rows = [w[k * wide : (k + 1) * wide] for k in range(self.outputs)]
        y = [weighed(row[:-1], z, row[-1]) for row in rows]
        for _ in range(self.units):
            s = weighed(w[unit : unit + self.features], z, w[unit + self.features])
            found = clip(s, -REACH, REACH) ** self.power if self.power else tanh(s)
            y = [total + a * found for total, a in zip(y, w[unit + wide : unit + wide + self.outputs], strict=True)]
            unit += wide + self.outputs
        return y


@inner
def curve(s: float, power: int) -> float:
    """Return f(s)."""
    if power == 0:
        return math.tanh(s)
    s = min(max(s, -REACH), REACH)
    found = s
    for _ in range(power - 1):
        found *= s
    return found


@inner
def slope(s: float, power: int) -> float:
    """Return f'(s)."""
    if power == 0:
        t = math.tanh(s)
        return 1.0 - t * t
    if abs(s) > REACH:
        return 0.0
    found = float(power)
    for _ in range(power - 1):
        found *= s
    return found


@inner
def mapped(w: Any, at: int, z: Any, features: int, outputs: int, units: int, power: int, y: Any) -> None:
    """Write the outputs to y (outputs,)."""
    wide = features + 1
    for k in range(outputs):
        y[k] = activation(w, at + k * wide, z, features)
    unit = at + outputs * wide
    for _ in range(units):
        found = curve(activation(w, unit, z, features), power)
        for k in range(outputs):
            y[k] += w[unit + wide + k] * found
        unit += wide + outputs


@inner
def differentiated(w: Any, at: int, z: Any, features: int, outputs: int, units: int, power: int, by_z: Any) -> None:
    """Write the derivatives by the features to by_z, (outputs x features) along rows."""
    wide = features + 1
    for k in range(outputs):
        for j in range(features):
            by_z[k * features + j] = w[at + k * wide + j]
    unit = at + outputs * wide
    for _ in range(units):
        rate = slope(activation(w, unit, z, features), power)
        for k in range(outputs):
            factor = w[unit + wide + k] * rate
            for j in range(features):
                by_z[k * features + j] += factor * w[unit + j]
        unit += wide + outputs
