"""Small networks as blocks of a law."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import perceptron, registers
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, absolute, tanh

Array = NDArray[np.float64]
Kernels = tuple[Callable[..., None], Callable[..., None], Callable[..., None]]


@dataclass(frozen=True, kw_only=True)
class Softsign(Block):
    """y_k = sum_i a_ki softsign(W_i z + b_i): one hidden layer, bounded by sum |a|, no function to evaluate.

    Weights, for each unit: W_i (features,), b_i, a_i (outputs,).
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
                s = w[at + width * i + features]
                for j in range(features):
                    s += w[at + width * i + j] * z[j]
                t = s / (1.0 + abs(s))
                for k in range(outputs):
                    y[k] += w[at + width * i + features + 1 + k] * t

        @inner
        def slopes(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            for k in range(outputs):
                y[k] = 0.0
                for j in range(features):
                    by_z[k * features + j] = 0.0
            for i in range(units):
                s = w[at + width * i + features]
                for j in range(features):
                    s += w[at + width * i + j] * z[j]
                slope = 1.0 / (1.0 + abs(s))
                t = s * slope
                slope *= slope
                for k in range(outputs):
                    a = w[at + width * i + features + 1 + k]
                    y[k] += a * t
                    for j in range(features):
                        by_z[k * features + j] += a * slope * w[at + width * i + j]

        @inner
        def weight_slopes(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            for i in range(units):
                s = w[at + width * i + features]
                for j in range(features):
                    s += w[at + width * i + j] * z[j]
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

        return value, slopes, weight_slopes

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        width = self.features + 1 + self.outputs
        y: list[Scalar] = [0.0] * self.outputs
        for i in range(self.units):
            of = w[width * i : width * (i + 1)]
            s = sum((a * value for a, value in zip(of, z, strict=False)), of[self.features])
            t = s / (1.0 + absolute(s))
            y = [total + a * t for total, a in zip(y, of[self.features + 1 :], strict=True)]
        return y


@dataclass(frozen=True, kw_only=True)
class Perceptron(Block):
    """y = W_L tanh(... tanh(W_1 z + b_1) ...) + b_L, computed in vector registers; its weights are packed ones and the
    system's only ones, see :class:`~.perceptron.Perceptron`. A fit does not learn them.
    """

    widths: tuple[int, ...]

    @property
    def layout(self) -> perceptron.Perceptron:
        return perceptron.Perceptron(widths=self.widths)

    @property
    def features(self) -> int:  # type: ignore[override]
        return self.widths[0]

    @property
    def outputs(self) -> int:  # type: ignore[override]
        return self.widths[-1]

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.layout.size

    @property
    def kernels(self) -> Kernels:
        parts, features, outputs = perceptron.passes(self.layout), self.features, self.outputs
        forward, output, gradient, values, scratch = (
            parts.forward,
            parts.output,
            parts.gradient,
            parts.values,
            registers.scratch,
        )

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            memory = scratch(values)
            for j in range(features):
                memory[j] = z[j]
            forward(w, memory)
            for k in range(outputs):
                y[k] = output(w, memory, k)

        @inner
        def slopes(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            memory, row = scratch(values), scratch(features)
            for j in range(features):
                memory[j] = z[j]
            forward(w, memory)
            for k in range(outputs):
                y[k] = output(w, memory, k)
                gradient(w, memory, k, row)
                for j in range(features):
                    by_z[k * features + j] = row[j]

        return value, slopes, _not_learnt

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        values = list(z)
        *hidden, (matrix, bias) = self.layout.unpacked(w)
        for rows, biases in hidden:
            values = [tanh(_weighed(row, values, b)) for row, b in zip(rows, biases, strict=True)]
        return [_weighed(row, values, b) for row, b in zip(matrix, bias, strict=True)]


@dataclass(frozen=True, kw_only=True)
class Polynomial(Block):
    """y = sum_j w_j prod_i z_i^e_ji. exponents: e, of each term (features,). Weights: the coefficients (terms,)."""

    exponents: tuple[tuple[int, ...], ...]
    features: int
    outputs: int = 1
    at: int = 0

    @property
    def size(self) -> int:  # type: ignore[override]
        return len(self.exponents)

    @property
    def kernels(self) -> Kernels:
        factors = [[i for i, power in enumerate(term) for _ in range(power)] for term in self.exponents]
        order = np.array([i for term in factors for i in term], dtype=np.int64)
        ends = np.cumsum([0, *(len(term) for term in factors)])
        terms, features = len(factors), self.features

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            y[0] = 0.0
            for j in range(terms):
                product = w[at + j]
                for k in range(ends[j], ends[j + 1]):
                    product *= z[order[k]]
                y[0] += product

        @inner
        def slopes(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            value(w, at, z, y)
            for i in range(features):
                by_z[i] = 0.0
            for j in range(terms):
                for k in range(ends[j], ends[j + 1]):
                    product = w[at + j]
                    for other in range(ends[j], ends[j + 1]):
                        if other != k:
                            product *= z[order[other]]
                    by_z[order[k]] += product

        @inner
        def weight_slopes(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            for j in range(terms):
                product = factors[0]
                for k in range(ends[j], ends[j + 1]):
                    product *= z[order[k]]
                row[start + j] += product

        return value, slopes, weight_slopes

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        total: Scalar = 0.0
        for weight, term in zip(w, self.exponents, strict=True):
            product = weight
            for value, power in zip(z, term, strict=True):
                for _ in range(power):
                    product = product * value
            total = total + product
        return [total]


@dataclass(frozen=True, kw_only=True)
class GatedUnits(Block):
    """A layer of gated recurrent units with its readout, from drives u (inputs,) and hidden states h (units,).

        r = s(A_r u + b_r + W_r h),  k = s(A_k u + b_k + W_k h),  s(a) = (1 + tanh(a / 2)) / 2
        n = tanh(A_n u + b_n + r (W_n h + c)),  h+ = k h + (1 - k) n,  y = D h+ + e

    features: u, h. outputs: y (readouts,), h+. Weights: A (3 units, inputs; rows r, k, n), b (3 units,), W (3 units,
    units), c (units,), D (readouts, units), e (readouts,), and behind them what a model adds that is not read here. A
    fit by least squares does not learn them.
    Cho et al. (2014), section 2.3, with the reset gate after the matrix, as cuDNN and PyTorch have it.
    """

    units: int
    size: int
    inputs: int = 1
    readouts: int = 1

    @property
    def features(self) -> int:  # type: ignore[override]
        return self.inputs + self.units

    @property
    def outputs(self) -> int:  # type: ignore[override]
        return self.readouts + self.units

    @property
    def places(self) -> tuple[int, int, int, int]:
        """Where b, W, c and D begin among the weights; e follows D."""
        bias = 3 * self.units * self.inputs
        matrix = bias + 3 * self.units
        reset_bias = matrix + 3 * self.units**2
        return bias, matrix, reset_bias, reset_bias + self.units

    @property
    def kernels(self) -> Kernels:
        units, drives, readouts, scratch = self.units, self.inputs, self.readouts, registers.scratch
        bias, matrix, reset_bias, readout = self.places
        wide = drives + units

        @inner
        def gates(w: Any, at: int, z: Any, i: int, out: Any) -> None:
            reset, keep, new = w[at + bias + i], w[at + bias + units + i], w[at + bias + 2 * units + i]
            for j in range(drives):
                reset += w[at + i * drives + j] * z[j]
                keep += w[at + (units + i) * drives + j] * z[j]
                new += w[at + (2 * units + i) * drives + j] * z[j]
            memory = w[at + reset_bias + i]
            row = at + matrix + i * units
            for j in range(units):
                reset += w[row + j] * z[drives + j]
                keep += w[row + units * units + j] * z[drives + j]
                memory += w[row + 2 * units * units + j] * z[drives + j]
            r = 0.5 + 0.5 * math.tanh(0.5 * reset)
            out[0], out[1], out[2] = r, 0.5 + 0.5 * math.tanh(0.5 * keep), math.tanh(new + r * memory)
            out[3] = memory

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            gate = scratch(4)
            for k in range(readouts):
                y[k] = w[at + readout + readouts * units + k]
            for i in range(units):
                gates(w, at, z, i, gate)
                y[readouts + i] = gate[2] + gate[1] * (z[drives + i] - gate[2])
                for k in range(readouts):
                    y[k] += w[at + readout + k * units + i] * y[readouts + i]

        @inner
        def slopes(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            gate = scratch(4)
            for k in range(readouts):
                y[k] = w[at + readout + readouts * units + k]
                for j in range(wide):
                    by_z[k * wide + j] = 0.0
            for i in range(units):
                gates(w, at, z, i, gate)
                r, k, n, memory = gate[0], gate[1], gate[2], gate[3]
                by_new, by_reset = (1.0 - k) * (1.0 - n * n), r * (1.0 - r)
                by_keep = k * (1.0 - k) * (z[drives + i] - n)
                y[readouts + i] = n + k * (z[drives + i] - n)
                row, own = at + matrix + i * units, (readouts + i) * wide
                for j in range(drives):
                    by_z[own + j] = (
                        by_new * (w[at + (2 * units + i) * drives + j] + memory * by_reset * w[at + i * drives + j])
                        + by_keep * w[at + (units + i) * drives + j]
                    )
                for j in range(units):
                    by_z[own + drives + j] = (
                        by_new * (memory * by_reset * w[row + j] + r * w[row + 2 * units * units + j])
                        + by_keep * w[row + units * units + j]
                    )
                by_z[own + drives + i] += k
                for out in range(readouts):
                    weight = w[at + readout + out * units + i]
                    y[out] += weight * y[readouts + i]
                    for j in range(wide):
                        by_z[out * wide + j] += weight * by_z[own + j]

        return value, slopes, _not_learnt

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        units, drives, readouts = self.units, self.inputs, self.readouts
        bias, matrix, reset_bias, readout = self.places

        def gate(number: int, i: int, memory: Scalar) -> Scalar:
            row = number * units + i
            return _weighed(w[row * drives : (row + 1) * drives], z[:drives], w[bias + row]) + memory

        y: list[Scalar] = list(w[readout + readouts * units : readout + readouts * (units + 1)])
        for i in range(units):
            rows = [w[matrix + (g * units + i) * units : matrix + (g * units + i + 1) * units] for g in range(3)]
            mixed = [_weighed(row, z[drives:], 0.0) for row in rows]
            r = 0.5 + 0.5 * tanh(0.5 * gate(0, i, mixed[0]))
            k = 0.5 + 0.5 * tanh(0.5 * gate(1, i, mixed[1]))
            n = tanh(gate(2, i, r * (mixed[2] + w[reset_bias + i])))
            y.append(n + k * (z[drives + i] - n))
            for out in range(readouts):
                y[out] = y[out] + w[readout + out * units + i] * y[-1]
        return y


@inner
def _not_learnt(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
    """Of blocks that are trained by other means."""


def _weighed(row: Any, values: Any, start: Any) -> Any:
    return sum((a * value for a, value in zip(row, values, strict=True)), start)
