"""Sensitivities: derivatives of the outputs of rollouts, in one pass with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.call import call_jacobian, pointer
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.rollout import (
    Dynamics,
    Starts,
    check_shapes,
    delayed,
    fed_back,
    feedback_gains,
    run_dynamics,
    unsensed_run,
)
from hybrid_sysid_ros.core.sensing import finest
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.arrays import Array


class Sensitivities:
    """Derivatives of the outputs of rollouts: the tangent-linear model, or forward sensitivities.

    They are exact for the discrete simulation, in one pass (Maly & Petzold 1996, Appl. Numer. Math. 20). Where dry
    friction begins or ceases to stick the simulation has a corner, and they jump.
    """

    def __init__(
        self,
        system: System,
        *,
        parameters: Sequence[int] | None = None,
        states: Sequence[int] | None = None,
        learn: bool = True,
    ) -> None:
        """Columns: derivatives by ``parameters`` (indices, none of a fixed one), by all weights, and by the initial
        ``states`` of a window, in this order; None stands for all. Without ``learn`` they are those by states alone.
        """
        functions = compiled(system)
        self._step, found = functions.jacobian(learn=learn)
        self._output, _ = functions.jacobian(output=True, learn=learn)
        self.columns, free = found, list(found.parameters)
        self.parameters = free if parameters is None else list(parameters)
        self.weights = found.weights
        self.states = list(range(found.states)) if states is None else list(states)
        self._wide, offset = found.count, found.states + found.inputs
        learnt = [offset + free.index(i) for i in self.parameters]
        learnt += range(offset + len(free), offset + len(free) + found.weights)
        self._names = names = [system.parameters[i].name for i in self.parameters]
        held = [system.delays.get(item.name) for item in system.inputs]
        self._learnt = np.array(learnt, dtype=np.int64)
        self._free_states = np.array(self.states, dtype=np.int64)
        self._delayed = np.array([names.index(name) if name in names else -1 for name in held], dtype=np.int64)

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self._learnt) + len(self.states)

    def rollouts(
        self,
        system: System,
        starts: Starts,
        x0: Array,
        inputs: Array,
        *,
        step: float,
        every: int,
        out: Array,
        feedback: Array | None = None,
    ) -> None:
        """Write the derivatives to ``out`` (samples, outputs, columns); see :func:`rollouts`."""
        check_shapes(system, x0, inputs)
        columns, gains = (self._learnt, self._free_states, self._delayed), feedback_gains(system, feedback)
        model, sensing = run_dynamics(self._step, self._output, system, step), system.sensing
        if sensing is None or not sensing.late:
            _tangents(model, starts, x0, inputs, gains, columns, every, self._wide, out)
            return
        fine = finest(starts, every)
        derivatives = np.empty((int(fine[-1, 2] + fine[-1, 3]), out.shape[1], out.shape[2]))
        _tangents(model, fine, x0, inputs, gains, columns, 1, self._wide, derivatives)
        outputs = unsensed_run(system, fine, x0, inputs, step, 1, feedback)[1]
        moved, read = sensing.moves(outputs, starts, every, step), sensing.readings(derivatives, starts, every, step)
        for _, _, samples, row in starts:
            rows = slice(row, row + samples)
            out[rows] = read[rows]
            for name, (output, derivative) in moved.items():
                if name in self._names:
                    out[rows, output, self._names.index(name)] += derivative[rows]


@kernel
def _tangents(
    model: Dynamics,
    starts: Starts,
    x0: Array,
    inputs: Array,
    feedback: Array,
    columns: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    every: int,
    wide: int,
    out: Array,
) -> None:
    """Write the tangents of rollouts to ``out`` (samples, outputs, columns).

    The Jacobians of both functions have ``wide`` columns. columns: those by parameters and weights, those by initial
    states, and for each input the column of its delay, -1 for none.
    """
    step, output, p, w, h, delays = model
    learnt, free_states, delayed_by = columns
    n, m, rows, count, last = x0.shape[1], inputs.shape[1], out.shape[1], out.shape[2], inputs.shape[0] - 1
    x, following, u, change = np.empty(n), np.empty(n), np.empty(m), np.zeros(m)
    y, jacobian, by_output = np.empty(rows), np.empty((n, wide)), np.empty((rows, wide))
    tangent, moved = np.empty((n, count)), np.empty((n, count))
    for window in range(starts.shape[0]):
        first, k, samples, row = starts[window]
        tangent[:, :] = 0.0
        for i in range(n):
            x[i] = x0[window, i]
        for c in range(free_states.shape[0]):
            tangent[free_states[c], learnt.shape[0] + c] = 1.0
        for sample in range(samples):
            for repeat in range(every + 1):
                if sample == 0 and repeat < every:
                    continue
                delayed(inputs, delays, first, k, u)
                fed_back(feedback, x, u)
                for j in range(m):
                    if delayed_by[j] >= 0:
                        whole = int(delays[j])
                        late = min(max(k - whole, first), last)
                        before = min(max(k - whole - 1, first), last)
                        change[j] = (inputs[before, j] - inputs[late, j]) / h
                if repeat < every:
                    call_jacobian(step, x, u, p, w, h, 0.0, following, jacobian)
                    _close(jacobian, feedback, n)
                    _chain(jacobian, tangent, learnt, delayed_by, change, moved)
                    x, following = following, x
                    tangent, moved = moved, tangent
                    k += 1
                else:
                    call_jacobian(output, x, u, p, w, h, 0.0, y, by_output)
                    _close(by_output, feedback, n)
                    _chain(by_output, tangent, learnt, delayed_by, change, out[row + sample])


@inner
def _close(jacobian: Any, feedback: Any, n: int) -> None:
    """Close the loop in a Jacobian of n states, in place: jacobian_x - jacobian_u F."""
    for j in range(feedback.shape[0]):
        for i in range(jacobian.shape[0]):
            for a in range(n):
                jacobian[i, a] -= jacobian[i, n + j] * feedback[j, a]


@inner
def _chain(jacobian: Any, tangent: Any, learnt: Any, delayed_by: Any, change: Any, out: Any) -> None:
    """The chain rule: out = jacobian_x tangent + [derivatives by parameters and weights] + jacobian_u (of delays)."""
    rows, width = jacobian.shape
    n, count = tangent.shape
    # Plain memory: an index that could be negative keeps the compiler from making vectors of a loop.
    s, t, o = pointer(jacobian), pointer(tangent), pointer(out)
    for i in range(rows):
        for c in range(learnt.shape[0]):
            o[i * count + c] = s[i * width + learnt[c]]
        for c in range(learnt.shape[0], count):
            o[i * count + c] = 0.0
        for j in range(change.shape[0]):
            if delayed_by[j] >= 0:
                o[i * count + delayed_by[j]] += s[i * width + n + j] * change[j]
        for a in range(n):
            derivative = s[i * width + a]
            if derivative != 0.0:
                for c in range(count):
                    o[i * count + c] += derivative * t[a * count + c]
