"""A policy in compiled code: from a question to bounded inputs, some hundred nanoseconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import registers
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.core.perceptron import Perceptron, passes

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Form:
    """What decides the compiled code: the network, the number of states and which of them is tracked; the network of
    the correction and the number of its parameters, where there is one.
    """

    network: Perceptron
    states: int
    output: int
    correction: Perceptron | None = None
    parameters: int = 0


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Functions for compiled code, and for Python, which compile when they are first asked for: a supervised controller
    has no need of most. A question is [x, d, u_previous, q_1..q_N], (states + 2 + horizon,).

    answer(question, memory, inputs): writes bounded inputs (outputs, 1); False where something is not a finite number,
    and ``inputs`` then mean nothing. memory: see :func:`memory`.
    inside(question, memory, training_range): whether the question is one like those of the training;
    training_range: :attr:`TrainingRange.packed`.
    in_parts(state, disturbance, u_previous, preview, memory, inputs): the answer to a question in its parts (states,),
    (1,), (1,), (horizon,). Raises ValueError for parts of other sizes.
    rows(features, memory, out): unbounded answers (samples, outputs) to features (samples, features).
    """

    answer: Callable[..., bool]
    inside: Callable[..., bool]
    in_parts: Callable[..., bool]
    rows: Callable[..., None]

    @cached_property
    def control(self) -> Callable[..., bool]:
        """``in_parts`` for Python, where one call is less than four copies. Raises TypeError for other arrays."""
        compiled: Callable[..., bool] = numba.njit(f"b1({'f8[:], ' * 4}f8[::1], f8[:, ::1])", **OPTIONS)(self.in_parts)
        return compiled

    @cached_property
    def contains(self) -> Callable[..., bool]:
        """``inside`` for Python."""
        compiled: Callable[..., bool] = numba.njit("b1(f8[::1], f8[::1], f8[::1])", **OPTIONS)(self.inside)
        return compiled

    @cached_property
    def raw(self) -> Callable[..., None]:
        """``rows`` for Python."""
        compiled: Callable[..., None] = numba.njit("void(f8[:, ::1], f8[::1], f8[:, ::1])", **OPTIONS)(self.rows)
        return compiled


def memory(
    *,
    input_limit: float,
    rate_limit: float,
    centre: Array,
    scale: Array,
    weights: Array,
    correction: Array,
    deviation: Array,
) -> Array:
    """All the numbers of a policy in one array, for each array is some 60 ns to a compiled function called from Python.

    deviation (parameters,): of the corrected parameters from their nominal values, in units of their spread; it is at
    the end and may be written to while the policy is used.
    """
    return np.concatenate([[input_limit, rate_limit], centre, 1.0 / scale, weights, correction, deviation])


@cache
def kernels(form: Form) -> Kernels:
    """The kernels of a form, made once in a process."""
    network, states, tracked = passes(form.network), form.states, form.output
    features, outputs = form.network.widths[0], form.network.widths[-1]
    previous, first = states + 1, states + 2
    begin = 2 + 2 * features
    end = begin + form.network.size
    forward, output, scratch, room = network.forward, network.output, registers.scratch, network.values
    parameters = form.parameters
    corrected = form.correction is not None
    # Without a correction its passes are those of the network: the branch is not compiled, but has to have types.
    other = passes(form.correction or form.network)
    correct, corrector, other_room = other.forward, other.output, other.values
    deviation = end + (form.correction.size if form.correction is not None else 0)

    @inner
    def standardise(features_or_question: Any, memory: Array, moved: float, values: Any) -> bool:
        """(z - centre) / scale, the preview less ``moved``."""
        for j in range(features):
            value = features_or_question[j] - (moved if j >= first else 0.0)
            if not np.isfinite(value):
                return False
            values[j] = (value - memory[2 + j]) * memory[2 + features + j]
        return True

    @inner
    def evaluate(values: Any, memory: Array, out: Array) -> None:
        """Unbounded inputs (outputs,)."""
        weights = memory[begin:end]
        if corrected:
            others = scratch(other_room)
            for j in range(features):
                others[j] = values[j]
            correct(memory[end:deviation], others)
        forward(weights, values)
        for k in range(outputs):
            total = output(weights, values, k)
            if corrected:
                for i in range(parameters):
                    total += corrector(memory[end:deviation], others, i * outputs + k) * memory[deviation + i]
            out[k] = memory[0] * total

    @inner
    def answer(question: Any, memory: Array, inputs: Array) -> bool:
        values = scratch(room)
        if not standardise(question, memory, question[tracked], values):
            return False
        evaluate(values, memory, inputs[:, 0])
        limit, rate = memory[0], memory[1]
        last = min(max(question[previous], -limit), limit)
        for k in range(outputs):
            u = inputs[k, 0]
            if not np.isfinite(u):
                return False
            u = min(max(u, last - rate), last + rate)
            last = min(max(u, -limit), limit)
            inputs[k, 0] = last
        return True

    def in_parts(state: Array, disturbance: Array, last: Array, preview: Array, memory: Array, inputs: Array) -> bool:
        if len(state) != states or len(disturbance) != 1 or len(last) != 1 or len(preview) != features - first:
            raise ValueError("a policy's question has other sizes than its network")
        question = scratch(features)
        for j in range(states):
            question[j] = state[j]
        question[states], question[previous] = disturbance[0], last[0]
        for j in range(features - first):
            question[first + j] = preview[j]
        return answer(question, memory, inputs)  # type: ignore[no-any-return]

    @inner
    def inside(question: Array, memory: Array, training_range: Array) -> bool:
        values = scratch(features)
        moved = question[tracked]
        if not standardise(question, memory, moved, values):
            return False
        for j in range(features):
            value = question[j] - (moved if j >= first else 0.0)
            if value < training_range[j] or value > training_range[features + j]:
                return False
        reach, row = training_range[2 * features], 2 * features + 1
        total = 0.0
        for i in range(features):
            distance = 0.0
            for j in range(i + 1):
                distance += training_range[row + j] * values[j]
            total += distance * distance
            row += features
        return bool(total <= reach * reach)

    def rows(samples: Array, memory: Array, out: Array) -> None:
        values = scratch(room)
        for i in range(samples.shape[0]):
            if standardise(samples[i], memory, 0.0, values):
                evaluate(values, memory, out[i])
            else:
                out[i, :] = np.nan

    return Kernels(answer=answer, inside=inside, in_parts=in_parts, rows=rows)
