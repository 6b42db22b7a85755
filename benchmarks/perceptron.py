"""A layered network, computed in vector registers: value and gradient in some hundred nanoseconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import registers
from hybrid_sysid_ros.core.blocks import Block, Kernels, not_learnt, weighed
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, tanh
from hybrid_sysid_ros.core.networks import NetworkLayers
from hybrid_sysid_ros.core.networks.tanh_layers import column_sum, widths_of
from hybrid_sysid_ros.core.registers import (
    behind,
    load_numbers,
    multiplied,
    scratch,
    store,
    summed,
    tanh_derivative,
    zero,
)
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LANES = (32, 16, 8)
"""Widths of the registers a layer is computed in: the widest that leaves none of it empty."""


@dataclass(frozen=True, kw_only=True)
class Perceptron(Block):
    """y = W_L tanh(... tanh(W_1 z + b_1) ...) + b_L.

    Hidden layers are filled up with idle units to multiples of eight; :meth:`packed` makes the weights.
    Derivatives by these are not computed: a fit does not learn them. Raises UserError for layers without units.
    """

    widths: tuple[int, ...]
    """Of the features z, each hidden layer and the outputs y."""
    at: int = 0

    def __post_init__(self) -> None:
        if len(self.widths) < 3 or min(self.widths) < 1:
            raise UserError(f"network: widths {self.widths} need features, a hidden layer and outputs, each above 0")

    @classmethod
    def of(cls, layers: NetworkLayers) -> Perceptron:
        """The network of layers (W (out, in), b (out,)). Raises UserError where they don't fit each other."""
        return cls(widths=widths_of(layers))

    @property
    def padded(self) -> tuple[int, ...]:
        """Widths of the hidden layers as they are computed."""
        return tuple(-(-width // 8) * 8 for width in self.widths[1:-1])

    @property
    def lanes(self) -> int:
        return next(lanes for lanes in LANES if all(width % lanes == 0 for width in self.padded))

    @property
    def features(self) -> int:  # type: ignore[override]
        return self.widths[0]

    @property
    def outputs(self) -> int:  # type: ignore[override]
        return self.widths[-1]

    @property
    def size(self) -> int:  # type: ignore[override]
        """Number of packed weights."""
        return len(self.packed([(np.zeros((b, a)), np.zeros(b)) for a, b in pairwise(self.widths)]))

    def packed(self, layers: NetworkLayers) -> Array:
        """Weights (size,) as the compiled forms read them: along rows.

        Each hidden layer by its columns, then its biases, then (all but the first) by its rows, which the gradient
        needs; the output layer by its rows, then its biases.
        """
        parts: list[Array] = []
        before = self.widths[0]
        for (matrix, bias), width in zip(layers[:-1], self.padded, strict=True):
            whole = np.zeros((width, before))
            whole[: matrix.shape[0], : matrix.shape[1]] = matrix
            parts += [whole.T.ravel(), np.pad(bias, (0, width - len(bias)))]
            if len(parts) > 2:
                parts.append(whole.ravel())
            before = width
        matrix, bias = layers[-1]
        parts += [np.pad(matrix, ((0, 0), (0, before - matrix.shape[1]))).ravel(), bias]
        return np.concatenate(parts).astype(float)

    def unpacked(self, weights: Sequence[Any]) -> list[tuple[list[list[Any]], list[Any]]]:
        """The layers (W, b) as nested lists, idle units left out."""
        layers = []
        at, before = 0, self.widths[0]
        for index, (width, units) in enumerate(zip(self.padded, self.widths[1:-1], strict=True)):
            inputs = self.widths[index]
            matrix = [[weights[at + j * width + i] for j in range(inputs)] for i in range(units)]
            at += before * width
            layers.append((matrix, [weights[at + i] for i in range(units)]))
            at += width + (before * width if index else 0)
            before = width
        matrix = [[weights[at + k * before + i] for i in range(self.widths[-2])] for k in range(self.widths[-1])]
        at += self.widths[-1] * before
        return [*layers, (matrix, [weights[at + k] for k in range(self.widths[-1])])]

    @property
    def places(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Where the layers' values begin in a row of all, and where their weights do."""
        columns = (self.widths[0], *self.padded[:-1])
        sizes = [(1 + (k > 0)) * a * b + b for k, (a, b) in enumerate(zip(columns, self.padded, strict=True))]
        first = -(-self.widths[0] // 8) * 8  # layers begin with a line of the cache
        return tuple(accumulate((first, *self.padded), initial=0)), tuple(accumulate(sizes, initial=0))

    @property
    def kernels(self) -> Kernels:
        features, lanes, widths, depth = self.widths[0], self.lanes, self.padded, len(self.padded)
        columns, (begins, starts) = (features, *widths[:-1]), self.places
        outputs, last, widest = self.widths[-1], widths[-1], max(widths)
        memory_size = begins[-1]

        @inner
        def forward(w: Any, z: Any, values: Any) -> None:
            for j in range(features):
                values[j] = z[j]
            for layer in range(depth):
                width, count, begin = widths[layer], columns[layer], begins[layer]
                for block in range(0, width, lanes):
                    bias = load_numbers(w, starts[layer] + count * width + block, lanes)
                    total = column_sum(w, starts[layer] + block, width, behind(values, begin), count, bias, lanes)
                    store(values, begins[layer + 1] + block, registers.tanh(total))

        @inner
        def output(w: Any, values: Any, k: int) -> float:
            total = w[starts[depth] + outputs * last + k]
            for block in range(0, last, lanes):
                row = load_numbers(w, starts[depth] + k * last + block, lanes)
                total += summed(multiplied(row, load_numbers(values, begins[depth] + block, lanes)))
            return total

        @inner
        def gradient(w: Any, values: Any, k: int, out: Any) -> None:
            factors, others = scratch(widest), scratch(widest)
            for block in range(0, last, lanes):
                row = load_numbers(w, starts[depth] + k * last + block, lanes)
                store(
                    factors, block, multiplied(row, tanh_derivative(load_numbers(values, begins[depth] + block, lanes)))
                )
            for layer in range(depth - 1, 0, -1):
                width, count = widths[layer], columns[layer]
                rows = starts[layer] + count * width + width
                for block in range(0, count, lanes):
                    total = column_sum(w, rows + block, count, factors, width, zero(lanes), lanes)
                    store(
                        others,
                        block,
                        multiplied(total, tanh_derivative(load_numbers(values, begins[layer] + block, lanes))),
                    )
                factors, others = others, factors
            for j in range(features):
                total_derivative = 0.0
                for block in range(0, widths[0], lanes):
                    total_derivative += summed(
                        multiplied(load_numbers(w, j * widths[0] + block, lanes), load_numbers(factors, block, lanes))
                    )
                out[j] = total_derivative

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            memory, own = scratch(memory_size), behind(w, at)
            forward(own, z, memory)
            for k in range(outputs):
                y[k] = output(own, memory, k)

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            memory, own = scratch(memory_size), behind(w, at)
            forward(own, z, memory)
            for k in range(outputs):
                y[k] = output(own, memory, k)
                gradient(own, memory, k, behind(by_z, k * features))

        return value, jacobian, not_learnt

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        values = list(z)
        *hidden, (matrix, bias) = self.unpacked(w)
        for rows, biases in hidden:
            values = [tanh(weighed(row, values, b)) for row, b in zip(rows, biases, strict=True)]
        return [weighed(row, values, b) for row, b in zip(matrix, bias, strict=True)]
