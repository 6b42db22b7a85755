"""Compiled simulations of a state-space model with scaled signals, with or without derivatives by its weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.core.networks.softsign import activation
from hybrid_sysid_ros.extensions.state_space.affine_map import curve, differentiated, mapped, slope
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Sizes of a model: states, inputs, outputs, units of its hidden layer, and their power."""

    states: int
    inputs: int
    outputs: int
    units: int = 0
    power: int = 0

    @property
    def wide(self) -> int:
        """Numbers in a row of a map, with its constant."""
        return self.states + self.inputs + 1

    @property
    def units_at(self) -> int:
        """Where the units begin among the weights."""
        return self.states * self.wide

    @property
    def readout_at(self) -> int:
        """Where the map of the outputs begins."""
        return self.units_at + self.units * (self.wide + self.states)

    @property
    def count(self) -> int:
        return self.readout_at + self.outputs * self.wide

    @property
    def numbers(self) -> tuple[int, int, int, int, int]:
        """All sizes, for compiled code."""
        return self.states, self.inputs, self.outputs, self.units, self.power


@kernel
def simulate_states(w: Array, sizes: tuple[int, int, int, int, int], inputs: Array, x: Array, states: Array) -> None:
    """Write the states (samples, states) before each input; x (states,) becomes the one behind the last."""
    n, m, _, units, power = sizes
    z, following = np.empty(n + m), np.empty(n)
    for k in range(inputs.shape[0]):
        states[k], z[:n], z[n:] = x, x, inputs[k]
        mapped(w, 0, z, n + m, n, units, power, following)
        x[:] = following


@kernel
def raise_to_largest(w: Array, sizes: tuple[int, int, int, int, int], inputs: Array, x: Array, largest: Array) -> None:
    """Raise the entries of ``largest`` (units,) to the largest magnitudes of the units' arguments."""
    n, m, _, units, power = sizes
    z, following = np.empty(n + m), np.empty(n)
    for k in range(inputs.shape[0]):
        z[:n], z[n:] = x, inputs[k]
        for i in range(units):
            at = n * (n + m + 1) + i * (n + m + 1 + n)
            largest[i] = max(largest[i], abs(activation(w, at, z, n + m)))
        mapped(w, 0, z, n + m, n, units, power, following)
        x[:] = following


@kernel
def tangents(
    w: Array,
    sizes: tuple[int, int, int, int, int],
    roles: NDArray[np.int64],
    inputs: Array,
    wanted: Array,
    x: Array,
    tangent: Array,
    errors: Array,
    jacobian: Array,
) -> None:
    """Write errors (samples, outputs) and derivatives of the outputs (samples x outputs, columns).

    x (states,) and tangent (states, columns) go on from the last chunk. Columns are the free weights, then the first
    state.
    """
    n, m, p, units, power = sizes
    wide, columns, free = n + m + 1, tangent.shape[1], roles.shape[0]
    readout = n * wide + units * (wide + n)
    z, following, y = np.ones(wide), np.empty(n), np.empty(p)
    by_z, moved = np.empty(n * (n + m)), np.empty((n, columns))
    found, rate = np.empty(units), np.empty(units)
    for k in range(inputs.shape[0]):
        z[:n], z[n : n + m] = x, inputs[k]
        mapped(w, readout, z, n + m, p, 0, 0, y)
        for j in range(p):
            errors[k, j] = wanted[k, j] - y[j]
            row = jacobian[k * p + j]
            row[:] = 0.0
            for a in range(n):
                weight = w[readout + j * wide + a]
                for c in range(columns):
                    row[c] += weight * tangent[a, c]
        mapped(w, 0, z, n + m, n, units, power, following)
        differentiated(w, 0, z, n + m, n, units, power, by_z)
        for i in range(n):
            for c in range(columns):
                moved[i, c] = 0.0
            for a in range(n):
                factor = by_z[i * (n + m) + a]
                if factor != 0.0:
                    for c in range(columns):
                        moved[i, c] += factor * tangent[a, c]
        for i in range(units):
            s = activation(w, n * wide + i * (wide + n), z, n + m)
            found[i], rate[i] = curve(s, power), slope(s, power)
        for c in range(free):
            kind, row_at, column = roles[c, 0], roles[c, 1], roles[c, 2]
            if kind == 0:
                moved[row_at, c] += z[column]
            elif kind == 1:
                at = n * wide + row_at * (wide + n) + wide
                for i in range(n):
                    moved[i, c] += w[at + i] * rate[row_at] * z[column]
            elif kind == 2:
                moved[column, c] += found[row_at]
            else:
                jacobian[k * p + row_at, c] += z[column]
        x[:] = following
        tangent[:, :] = moved
