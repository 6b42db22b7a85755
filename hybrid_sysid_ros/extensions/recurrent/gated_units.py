"""A layer of gated recurrent units."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.blocks import Block, Kernels, not_learnt, weighed
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, tanh
from hybrid_sysid_ros.core.registers import scratch


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
    at: int = 0

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

    def _gates(self) -> Callable[..., None]:
        """gates(w, at, z, i, out): r, k, n and W_n h + c of unit i."""
        units, drives = self.units, self.inputs
        bias, matrix, reset_bias, _ = self.places

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

        return gates

    @property
    def kernels(self) -> Kernels:
        units, drives, readouts, gates = self.units, self.inputs, self.readouts, self._gates()
        _, matrix, _, readout = self.places
        wide = drives + units

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
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
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

        return value, jacobian, not_learnt

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        units, drives, readouts = self.units, self.inputs, self.readouts
        bias, matrix, reset_bias, readout = self.places

        def gate(number: int, i: int, memory: Scalar) -> Scalar:
            row = number * units + i
            return weighed(w[row * drives : (row + 1) * drives], z[:drives], w[bias + row]) + memory

        y: list[Scalar] = list(w[readout + readouts * units : readout + readouts * (units + 1)])
        for i in range(units):
            rows = [w[matrix + (g * units + i) * units : matrix + (g * units + i + 1) * units] for g in range(3)]
            mixed = [weighed(row, z[drives:], 0.0) for row in rows]
            r = 0.5 + 0.5 * tanh(0.5 * gate(0, i, mixed[0]))
            k = 0.5 + 0.5 * tanh(0.5 * gate(1, i, mixed[1]))
            n = tanh(gate(2, i, r * (mixed[2] + w[reset_bias + i])))
            y.append(n + k * (z[drives + i] - n))
            for out in range(readouts):
                y[out] = y[out] + w[readout + out * units + i] * y[-1]
        return y
