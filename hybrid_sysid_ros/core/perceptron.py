"""A layered network that laws and policies evaluate: value and gradient in some hundred nanoseconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import registers
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]
Layers = Sequence[tuple[Array, Array]]

LANES = (32, 16, 8)
"""Widths of the registers a layer is computed in: the widest that leaves none of it empty."""


@dataclass(frozen=True, kw_only=True)
class Perceptron:
    """y = W_L tanh(... tanh(W_1 z + b_1) ...) + b_L.

    widths: of the features z, each hidden layer and the outputs y. Hidden layers are filled up with idle units to
    multiples of eight; :meth:`packed` makes the weights that the functions here take.
    """

    widths: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.widths) < 3 or min(self.widths) < 1:
            raise UserError(f"network: widths {self.widths} need features, a hidden layer and outputs, each above 0")

    @classmethod
    def of(cls, layers: Layers) -> Perceptron:
        """The network of layers (W (out, in), b (out,)). Raises UserError where they don't fit each other."""
        for (first, _), (second, _) in pairwise(layers):
            if second.shape[1] != len(first):
                raise UserError(f"network: a layer of {len(first)} units is followed by one for {second.shape[1]}")
        for matrix, bias in layers:
            if bias.shape != matrix.shape[:1]:
                raise UserError(f"network: a layer has {len(matrix)} rows and biases of shape {bias.shape}")
        return cls(widths=(layers[0][0].shape[1], *(len(bias) for _, bias in layers)))

    @property
    def padded(self) -> tuple[int, ...]:
        """Widths of the hidden layers as they are computed."""
        return tuple(-(-width // 8) * 8 for width in self.widths[1:-1])

    @property
    def lanes(self) -> int:
        return next(lanes for lanes in LANES if all(width % lanes == 0 for width in self.padded))

    @property
    def size(self) -> int:
        """Number of packed weights."""
        return len(self.packed([(np.zeros((b, a)), np.zeros(b)) for a, b in pairwise(self.widths)]))

    def packed(self, layers: Layers) -> Array:
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


@dataclass(frozen=True, kw_only=True)
class Passes:
    """forward(w, values): ``values`` (values,) begins with the features and receives the hidden layers after them.
    output(w, values, k): y_k. gradient(w, values, k, out): dy_k / dz into ``out`` (features,). All compiled;
    ``values``: how long that memory is.
    """

    forward: Callable[..., None]
    output: Callable[..., float]
    gradient: Callable[..., None]
    values: int


@cache
def passes(network: Perceptron) -> Passes:
    """The compiled passes through a network, made once in a process."""
    load, store, zero = registers.load, registers.store, registers.zero
    added, multiplied, plus_scaled = registers.added, registers.multiplied, registers.plus_scaled
    summed, tanh, tanh_slope, scratch = registers.summed, registers.tanh, registers.tanh_slope, registers.scratch
    features, lanes, widths, depth = network.widths[0], network.lanes, network.padded, len(network.padded)
    columns = (features, *widths[:-1])
    begins = tuple(int(total) for total in np.cumsum([0, features, *widths]))
    doubled = tuple(int(layer > 0) for layer in range(depth))
    sizes = [(1 + twice) * a * b + b for a, b, twice in zip(columns, widths, doubled, strict=True)]
    starts = tuple(int(total) for total in np.cumsum([0, *sizes]))
    outputs, last, widest = network.widths[-1], widths[-1], max(widths)

    @inner
    def product(w: Any, rows: int, width: int, vector: Any, begin: int, count: int, start: Any) -> Any:
        """Start + sum_j row_j vector_j for one block of lanes, in two chains that don't wait for each other."""
        even, odd = start, zero(lanes)
        for j in range(0, count - 1, 2):
            even = plus_scaled(even, load(w, rows + j * width, lanes), vector[begin + j])
            odd = plus_scaled(odd, load(w, rows + (j + 1) * width, lanes), vector[begin + j + 1])
        if count % 2:
            even = plus_scaled(even, load(w, rows + (count - 1) * width, lanes), vector[begin + count - 1])
        return added(even, odd)

    def forward(w: Any, values: Any) -> None:
        for layer in range(depth):
            width, count, begin = widths[layer], columns[layer], begins[layer]
            for block in range(0, width, lanes):
                bias = load(w, starts[layer] + count * width + block, lanes)
                z = product(w, starts[layer] + block, width, values, begin, count, bias)
                store(values, begins[layer + 1] + block, tanh(z))

    def output(w: Any, values: Any, k: int) -> float:
        total = w[starts[depth] + outputs * last + k]
        for block in range(0, last, lanes):
            row = load(w, starts[depth] + k * last + block, lanes)
            total += summed(multiplied(row, load(values, begins[depth] + block, lanes)))
        return total

    def gradient(w: Any, values: Any, k: int, out: Any) -> None:
        slopes, others = scratch(widest), scratch(widest)
        for block in range(0, last, lanes):
            row = load(w, starts[depth] + k * last + block, lanes)
            store(slopes, block, multiplied(row, tanh_slope(load(values, begins[depth] + block, lanes))))
        for layer in range(depth - 1, 0, -1):
            width, count = widths[layer], columns[layer]
            rows = starts[layer] + count * width + width
            for block in range(0, count, lanes):
                total = product(w, rows + block, count, slopes, 0, width, zero(lanes))
                store(others, block, multiplied(total, tanh_slope(load(values, begins[layer] + block, lanes))))
            slopes, others = others, slopes
        for j in range(features):
            total_slope = 0.0
            for block in range(0, widths[0], lanes):
                total_slope += summed(multiplied(load(w, j * widths[0] + block, lanes), load(slopes, block, lanes)))
            out[j] = total_slope

    return Passes(
        forward=numba.njit(forward, **OPTIONS),
        output=numba.njit(output, **OPTIONS),
        gradient=numba.njit(gradient, **OPTIONS),
        values=begins[-1],
    )
