"""The simulation together with its derivatives by parameters, initial states and offsets of the inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.core.dual import dual_rows, lanes_for, linearised, seeding
from hybrid_sysid_ros.core.equation import Equation

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ForwardSensitivity:
    """windows(starts, x0s, inputs, delay_steps, every, p, w, h, rows, out): as
    :attr:`~hybrid_sysid_ros.core.simulation.Kernels.windows`, with ``out`` (samples, outputs, lanes).

    Lane 0 is the output, the next ones its derivatives by the named parameters, by the states at the beginning of the
    window and by constants added to the inputs. rows: memory, see :attr:`workspace`. Exact derivatives of the discrete
    simulation, in one pass: the tangent-linear model, or forward sensitivity (Maly & Petzold 1996, Appl. Numer. Math.
    20). Where dry friction begins or ceases to stick they have a jump, as the simulation has a corner.
    """

    windows: Callable[..., None]
    lanes: int
    states: int
    inputs: int

    @property
    def workspace(self) -> Array:
        """Memory of one thread."""
        return np.zeros((2 * self.states + self.inputs, self.lanes))


_COMPILED: dict[tuple[Any, ...], ForwardSensitivity] = {}


def forward_sensitivity(equation: Equation, names: tuple[str, ...]) -> ForwardSensitivity:
    """The kernels of an equation's form for some of its parameters, compiled once in a process (some seconds)."""
    key = (*equation.form, len(equation.states), len(equation.inputs), names)
    if key not in _COMPILED:
        _COMPILED[key] = _compile(equation, names)
    return _COMPILED[key]


def _compile(equation: Equation, names: tuple[str, ...]) -> ForwardSensitivity:
    states, inputs, measured = len(equation.states), len(equation.inputs), equation.outputs
    lanes = lanes_for(len(names) + states + inputs)
    slots = (names.index(item.name) + 1 if item.name in names else 0 for item in equation.parameters)
    seeded = seeding(lanes, tuple(slots))
    step = inner(equation.advance(linearised(0.0)))
    delayed = names.index("input_delay") + 1 if "input_delay" in names else 0
    first_state, first_input = 1 + len(names), 1 + len(names) + states

    def windows(
        starts: NDArray[np.int64],
        x0s: Array,
        inputs_held: Array,
        delay_steps: float,
        every: int,
        p: Any,
        w: Array,
        h: float,
        rows: Array,
        out: Array,
    ) -> None:
        whole = int(delay_steps)
        part = delay_steps - whole
        parameters = seeded(p)
        drive = dual_rows(rows[2 * states :], lanes)
        for window in range(starts.shape[0]):
            first, k, samples, offset = starts[window]
            rows[:] = 0.0
            for i in range(states):
                rows[i, 0] = x0s[window, i]
                rows[i, first_state + i] = 1.0
            for j in range(inputs):
                rows[2 * states + j, first_input + j] = 1.0
            begin = 0
            for output in range(len(measured)):
                for lane in range(lanes):
                    out[offset, output, lane] = rows[measured[output], lane]
            for sample in range(1, samples):
                for _ in range(every):
                    late = max(k - whole, first)
                    later = max(k - whole - 1, first)
                    for j in range(inputs):
                        rows[2 * states + j, 0] = (1.0 - part) * inputs_held[late, j] + part * inputs_held[later, j]
                        if delayed:
                            rows[2 * states + j, delayed] = (inputs_held[later, j] - inputs_held[late, j]) / h
                    end = states - begin
                    present = dual_rows(rows[begin : begin + states], lanes)
                    step(present, drive, parameters, w, h, dual_rows(rows[end : end + states], lanes))
                    begin = end
                    k += 1
                for output in range(len(measured)):
                    for lane in range(lanes):
                        out[offset + sample, output, lane] = rows[begin + measured[output], lane]

    return ForwardSensitivity(windows=numba.njit(windows, **OPTIONS), lanes=lanes, states=states, inputs=inputs)
