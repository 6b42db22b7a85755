"""The compiled form: simulation at some 50 ns a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import OPTIONS
from hybrid_sysid_ros.core.equation import Equation
from hybrid_sysid_ros.core.operations import COMPILED

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Compiled functions of one form of equation; the values of parameters and weights are arguments.

    step(x, u, p, w, h, following): one step; ``following`` (states,) receives the new state.
    rollout(x0, inputs, delay_steps, first, start, every, p, w, h, out): states at every ``every``-th step, out[0] = x0;
    inputs (steps, inputs) hold over each step, ``first`` is this record's first row, ``start`` the one to begin at.
    windows(starts, x0s, inputs, delay_steps, every, p, w, h, out): many rollouts from
    starts (windows, 4) = first, start, samples, offset into out (samples, states).
    """

    step: Callable[..., None]
    rollout: Callable[..., None]
    windows: Callable[..., None]


_COMPILED: dict[tuple[Any, ...], Kernels] = {}


def kernels(equation: Equation) -> Kernels:
    """The kernels of an equation's form, compiled once in a process (about a second)."""
    if equation.form not in _COMPILED:
        _COMPILED[equation.form] = _compile(equation)
    return _COMPILED[equation.form]


def _compile(equation: Equation) -> Kernels:
    step = numba.njit(equation.advance(COMPILED), **OPTIONS)

    def rollout(
        x0: Array,
        inputs: Array,
        delay_steps: float,
        first: int,
        start: int,
        every: int,
        p: Any,
        w: Array,
        h: float,
        out: Array,
    ) -> None:
        x = x0.copy()
        following = x0.copy()
        u = np.empty(inputs.shape[1])
        # A held input seen through a delay of (whole + part) steps has these means over each step.
        whole = int(delay_steps)
        part = delay_steps - whole
        out[0] = x
        k = start
        for sample in range(1, out.shape[0]):
            for _ in range(every):
                late = max(k - whole, first)
                later = max(k - whole - 1, first)
                for j in range(u.shape[0]):
                    u[j] = (1.0 - part) * inputs[late, j] + part * inputs[later, j]
                step(x, u, p, w, h, following)
                for i in range(x.shape[0]):
                    x[i] = following[i]
                k += 1
            for i in range(x.shape[0]):
                out[sample, i] = x[i]

    compiled_rollout = numba.njit(rollout, **OPTIONS)

    def windows(
        starts: NDArray[np.int64],
        x0s: Array,
        inputs: Array,
        delay_steps: float,
        every: int,
        p: Any,
        w: Array,
        h: float,
        out: Array,
    ) -> None:
        for i in range(starts.shape[0]):
            first, start, samples, offset = starts[i]
            compiled_rollout(x0s[i], inputs, delay_steps, first, start, every, p, w, h, out[offset : offset + samples])

    return Kernels(step=step, rollout=compiled_rollout, windows=numba.njit(windows, **OPTIONS))


def simulate(equation: Equation, initial_state: Array, inputs: Array, *, step: float, every: int = 1) -> Array:
    """Free run from one initial state, without re-initialisation.

    inputs (steps, inputs): mean of each input over each ``step`` [s]; before the first row the input is taken as
    inputs[0]. Returns states (1 + steps // every, states) at every ``every``-th step, beginning with the initial one.
    """
    rows = 1 + len(inputs) // every
    out = np.empty((rows, len(equation.states)))
    kernels(equation).rollout(
        np.ascontiguousarray(initial_state, dtype=float),
        np.ascontiguousarray(inputs, dtype=float),
        equation.delay / step,
        0,
        0,
        every,
        equation.named,
        equation.weights,
        step,
        out,
    )
    return out
