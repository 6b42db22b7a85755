"""Rollouts: free runs of a system from given states, many at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.core.call import call_jacobian, call_value
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.sensing import finest
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.arrays import Array

Starts = NDArray[np.int64]
"""Rollouts (windows, 4): first row of the record's inputs, first row of the rollout, samples, and row of the result."""


Dynamics = tuple[int, int, Array, Array, float, Array]
"""A system for compiled loops: addresses of step and output, parameters (parameters,), weights (weights,), the step [s]
and the delays of the inputs in steps (inputs,).
"""


def dynamics(step: int, output: int, system: System, h: float) -> Dynamics:
    """The dynamics of a system; step, output: addresses of functions with or without derivatives, h: the step [s]."""
    return step, output, system.values, system.weights, h, system.input_delays / h


def run_dynamics(step: int, output: int, system: System, h: float) -> Dynamics:
    """The dynamics in a run, whose readings are late by themselves and not by a delay of the inputs."""
    model, sensing = dynamics(step, output, system, h), system.sensing
    return model if sensing is None else (*model[:5], model[5] - sensing.common_lag / h)


@inner
def delayed(inputs: Any, delays: Any, first: int, k: int, u: Any) -> None:
    """The inputs (inputs,) that act over step k, of ``inputs`` (steps, inputs) that hold over each step.

    delays (inputs,) are in steps: a held input behind a delay of (whole + part) steps has a mean over each step.
    Before the row ``first`` the input is taken from that row.
    """
    for j in range(u.shape[0]):
        whole = int(delays[j])
        part = delays[j] - whole
        last = inputs.shape[0] - 1
        late = min(max(k - whole, first), last)
        later = min(max(k - whole - 1, first), last)
        u[j] = (1.0 - part) * inputs[late, j] + part * inputs[later, j]


@inner
def fed_back(feedback: Any, x: Any, u: Any) -> None:
    """Subtract the feedback of the states x (states,) from the inputs u (inputs,), in place: u - F x."""
    for j in range(feedback.shape[0]):
        for i in range(feedback.shape[1]):
            u[j] -= feedback[j, i] * x[i]


@kernel
def _rollouts(
    model: Dynamics,
    starts: Starts,
    x0: Array,
    inputs: Array,
    feedback: Array,
    every: int,
    states: Array,
    outputs: Array,
) -> None:
    """Write states (samples, states) and outputs (samples, outputs) of all rollouts."""
    step, output, p, w, h, delays = model
    x, following = np.empty(x0.shape[1]), np.empty(x0.shape[1])
    u, y = np.empty(inputs.shape[1]), np.empty(outputs.shape[1])
    for window in range(starts.shape[0]):
        first, k, samples, row = starts[window]
        for i in range(x.shape[0]):
            x[i] = x0[window, i]
        for sample in range(samples):
            if sample > 0:
                for _ in range(every):
                    delayed(inputs, delays, first, k, u)
                    fed_back(feedback, x, u)
                    call_value(step, x, u, p, w, h, 0.0, following)
                    x, following = following, x
                    k += 1
            for i in range(x.shape[0]):
                states[row + sample, i] = x[i]
            delayed(inputs, delays, first, k, u)
            fed_back(feedback, x, u)
            call_value(output, x, u, p, w, h, 0.0, y)
            for i in range(y.shape[0]):
                outputs[row + sample, i] = y[i]


def rollouts(
    system: System,
    starts: Starts,
    x0: Array,
    inputs: Array,
    *,
    step: float,
    every: int = 1,
    feedback: Array | None = None,
) -> tuple[Array, Array]:
    """States (samples, states) and outputs (samples, outputs) of free runs without re-initialisation.

    starts: see :data:`Starts`. x0 (windows, states). inputs (steps, inputs): mean of each input over each ``step`` [s].
    There is a sample every ``every`` steps; the first one is x0. feedback F (inputs, states): u - F x acts over a step
    in place of u, with x at its beginning, so that runs of an unstable system stay near a record. Outputs are as the
    sensors read them that the system knows. Raises ValueError for arrays of other sizes.
    """
    check_shapes(system, x0, inputs)
    if system.sensing is None or not system.sensing.late:
        return unsensed_run(system, starts, x0, inputs, step, every, feedback)
    fine = finest(starts, every)
    states, outputs = unsensed_run(system, fine, x0, inputs, step, 1, feedback)
    shown = np.empty((int((starts[:, 2] + starts[:, 3]).max()), states.shape[1]))
    for (_, _, samples, row), (_, _, steps, begin) in zip(starts, fine, strict=True):
        shown[row : row + samples] = states[begin : begin + steps : every]
    return shown, system.sensing.readings(outputs, starts, every, step)


def unsensed_run(
    system: System, starts: Starts, x0: Array, inputs: Array, step: float, every: int, feedback: Array | None
) -> tuple[Array, Array]:
    """States and outputs of rollouts, as no sensor reads them."""
    functions, total = compiled(system), int((starts[:, 2] + starts[:, 3]).max())
    states, outputs = np.empty((total, len(system.states))), np.empty((total, len(system.outputs)))
    model = run_dynamics(functions.step, functions.output, system, step)
    _rollouts(model, starts, x0, inputs, feedback_gains(system, feedback), every, states, outputs)
    return states, outputs


def simulate(system: System, initial_state: Array, inputs: Array, *, step: float, every: int = 1) -> Array:
    """States (1 + steps // every, states) of one free run from one initial state (states,); see :func:`rollouts`."""
    starts = np.array([[0, 0, 1 + len(inputs) // every, 0]])
    x0 = np.ascontiguousarray(initial_state, dtype=float)[None]
    states, _ = rollouts(system, starts, x0, np.ascontiguousarray(inputs, dtype=float), step=step, every=every)
    return states


def feedback_gains(system: System, feedback: Array | None) -> Array:
    """A feedback (inputs, states) for compiled loops; it has no rows where there is none."""
    n, m = len(system.states), len(system.inputs)
    if feedback is None:
        return np.zeros((0, n))
    if feedback.shape != (m, n):
        raise ValueError(f"{type(system).__name__}: feedback has shape {feedback.shape}: give {m} rows and {n} columns")
    return np.ascontiguousarray(feedback, dtype=float)


def check_shapes(system: System, x0: Array, inputs: Array) -> None:
    """Raise ValueError for arrays of other sizes, beyond whose ends compiled code would read and write."""
    n, m = len(system.states), len(system.inputs)
    if x0.ndim != 2 or inputs.ndim != 2 or x0.shape[1] != n or inputs.shape[1] != m:
        raise ValueError(
            f"{type(system).__name__}: states {x0.shape} and inputs {inputs.shape} must have {n} and {m} columns"
        )


@kernel
def advance(step: int, x: Array, u: Array, p: Array, w: Array, h: float, following: Array) -> None:
    """Call a compiled step by its address, from Python; ``following`` (states,) receives the new state."""
    call_value(step, x, u, p, w, h, 0.0, following)


def one_step(system: System, x: Array, u: Array, *, step: float) -> Array:
    """The states (states,) one step [s] after x (states,) under inputs u (inputs,) that act now, without delay.

    Raises ValueError for arrays of other sizes.
    """
    following = np.empty(len(system.states))
    given = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(u, dtype=float)
    check_shapes(system, given[0][None], given[1][None])
    advance(compiled(system).step, *given, system.values, system.weights, step, following)
    return following


def output_of(system: System, x: Array, u: Array) -> Array:
    """The outputs (outputs,) at states x (states,) under inputs u (inputs,) that act now, without delay."""
    outputs = np.empty(len(system.outputs))
    given = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(u, dtype=float)
    advance(compiled(system).output, *given, system.values, system.weights, 0.0, outputs)
    return outputs


def step_with_jacobian(
    system: System, x: ArrayLike, u: ArrayLike, *, step: float,
    smoothing: float = 0.0, output: bool = False, learn: bool = False,
) -> tuple[Array, Array]:  # fmt: skip
    """The states a step [s] after x (states,) under inputs u (inputs,) that act now, or the outputs there, and their
    Jacobian (rows, columns) by states and inputs, and with ``learn`` by parameters and weights.

    smoothing: velocity over which stick-slip is rounded, in the velocity's unit; 0: it is exact.
    """
    address, columns = compiled(system).jacobian(output=output, smooth=smoothing > 0.0, learn=learn)
    rows = len(system.outputs if output else system.states)
    value, jacobian = np.empty(rows), np.empty((rows, columns.count))
    given = np.array(x, dtype=float), np.array(u, dtype=float)
    check_shapes(system, given[0][None], given[1][None])
    _step_with_jacobian(address, *given, system.values, system.weights, step, smoothing, value, jacobian)
    return value, jacobian


@kernel
def _step_with_jacobian(
    address: int, x: Array, u: Array, p: Array, w: Array, h: float, smoothing: float, value: Array, jacobian: Array
) -> None:
    call_jacobian(address, x, u, p, w, h, smoothing, value, jacobian)
