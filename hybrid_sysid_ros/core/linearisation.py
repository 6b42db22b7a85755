"""The linearised form: a step and its Jacobian in one compiled pass."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.core.dual import dual_rows, lanes_for, linearised
from hybrid_sysid_ros.core.equation import Equation

Array = NDArray[np.float64]
Linearisation = Callable[..., None]
"""linearisation(x, u, p, w, h, substeps, rows, following, A, B): see :func:`linearisation`."""

_COMPILED: dict[tuple[Any, ...], Linearisation] = {}


def lanes_of(equation: Equation) -> int:
    """Lanes of the equation's dual numbers: a value and a derivative for each state and input."""
    return lanes_for(len(equation.states) + len(equation.inputs))


def workspace(equation: Equation) -> Array:
    """What one linearisation works in, (2 states + inputs, lanes)."""
    return np.zeros((2 * len(equation.states) + len(equation.inputs), lanes_of(equation)))


def linearisation(equation: Equation, *, smoothing: float) -> Linearisation:
    """Compiled linearisation of an equation's form, made once in a process.

    linearisation(x, u, p, w, h, substeps, rows, following, A, B): x (states,) and u (inputs,) held over ``substeps``
    steps of h [s]; p the named parameters, w (weights,), rows a :func:`workspace`. ``following`` (states,) receives the
    new state, A (states, states) and B (states, inputs) its derivatives. smoothing: as in
    :func:`~hybrid_sysid_ros.core.casadi_form.symbolic_step`.
    """
    key = (*equation.form, len(equation.states), len(equation.inputs), smoothing)
    if key not in _COMPILED:
        _COMPILED[key] = _compile(equation, smoothing)
    return _COMPILED[key]


def _compile(equation: Equation, smoothing: float) -> Linearisation:
    states, inputs, lanes = len(equation.states), len(equation.inputs), lanes_of(equation)
    step = inner(equation.advance(linearised(smoothing)))

    def linearise(
        x: Array,
        u: Array,
        p: Any,
        w: Array,
        h: float,
        substeps: int,
        rows: Array,
        following: Array,
        state_jacobian: Array,
        input_jacobian: Array,
    ) -> None:
        rows[:] = 0.0
        for i in range(states):
            rows[i, 0] = x[i]
            rows[i, 1 + i] = 1.0
        for j in range(inputs):
            rows[2 * states + j, 0] = u[j]
            rows[2 * states + j, 1 + states + j] = 1.0
        drive = dual_rows(rows[2 * states :], lanes)
        begin = 0
        for _ in range(substeps):
            end = states - begin
            present = dual_rows(rows[begin : begin + states], lanes)
            step(present, drive, p, w, h, dual_rows(rows[end : end + states], lanes))
            begin = end
        for i in range(states):
            following[i] = rows[begin + i, 0]
            for j in range(states):
                state_jacobian[i, j] = rows[begin + i, 1 + j]
            for j in range(inputs):
                input_jacobian[i, j] = rows[begin + i, 1 + states + j]

    compiled: Linearisation = numba.njit(linearise, **OPTIONS)
    return compiled
