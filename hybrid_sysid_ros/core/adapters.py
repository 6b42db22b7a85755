"""Compiled functions for loops that are not yet written by addresses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.call import call_slopes, call_value
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.system import System

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """step(x, u, p, w, h, following): one step; ``following`` (states,) receives the new state."""

    step: Callable[..., None]


_KERNELS: dict[Any, Kernels] = {}
_LINEARISATIONS: dict[Any, Callable[..., None]] = {}


def kernels(system: System) -> Kernels:
    """The step of a system's form."""
    if system.form not in _KERNELS:
        address = compiled(system).step

        @inner
        def step(x: Any, u: Any, p: Any, w: Any, h: float, following: Any) -> None:
            call_value(address, x, u, p, w, h, 0.0, following)

        _KERNELS[system.form] = Kernels(step=step)
    return _KERNELS[system.form]


def workspace(system: System) -> Array:
    """What one linearisation works in."""
    n, m = len(system.states), len(system.inputs)
    return np.zeros((4, n, n + m))


def linearisation(system: System, *, smoothing: float) -> Callable[..., None]:
    """A compiled function (x, u, p, w, h, substeps, rows, following, A, B).

    x (states,) and u (inputs,) held over ``substeps`` steps of h [s]; rows a :func:`workspace`. ``following`` (states,)
    receives the new state, A (states, states) and B (states, inputs) its derivatives.
    """
    key = (system.form, smoothing)
    if key in _LINEARISATIONS:
        return _LINEARISATIONS[key]
    address, _ = compiled(system).slopes(smooth=smoothing > 0.0)
    n, m = len(system.states), len(system.inputs)
    width = n + m

    @inner
    def linearise(
        x: Any, u: Any, p: Any, w: Any, h: float, substeps: int, rows: Any, following: Any, A: Any, B: Any
    ) -> None:
        slopes, total, moved = rows[0], rows[1], rows[2]
        state = rows[3, 0]
        for i in range(n):
            state[i] = x[i]
            for c in range(width):
                total[i, c] = 1.0 if i == c else 0.0
        for _ in range(substeps):
            call_slopes(address, state, u, p, w, h, smoothing, following, slopes)
            for i in range(n):
                for c in range(width):
                    change = slopes[i, c] if c >= n else 0.0
                    for a in range(n):
                        change += slopes[i, a] * total[a, c]
                    moved[i, c] = change
            for i in range(n):
                state[i] = following[i]
                for c in range(width):
                    total[i, c] = moved[i, c]
        for i in range(n):
            for a in range(n):
                A[i, a] = total[i, a]
            for j in range(m):
                B[i, j] = total[i, n + j]

    _LINEARISATIONS[key] = linearise
    return linearise
