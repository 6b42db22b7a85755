"""The memory of one horizon: what is asked, how the model predicts, a trajectory and the problem linearised about it.

N = horizon, n = states, m = inputs, p = outputs, v = N m: all inputs in a row, u_0 first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.stage_cost import StageWeights
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

PARTS = ("state", "disturbance", "previous_input", "preview")
"""Of an instance, as :meth:`~hybrid_sysid_ros.control.controller.Controller.control` calls them."""


class Instance(NamedTuple):
    """What changes from call to call; [x, d, u_previous, q_1, ..., q_N] in a row where it is one array."""

    state: Array
    """(n,), the one that the inputs will meet."""
    disturbance: Array
    """(m,), offset of the inputs."""
    previous: Array
    """(m,), the inputs before."""
    preview: Array
    """(N, p), reference of the outputs at the end of each interval."""

    def take(self, state: Array, disturbance: Array, previous: Array, preview: Array) -> None:
        """Write what is asked into these arrays."""
        self.state[:], self.disturbance[:], self.previous[:], self.preview[:] = state, disturbance, previous, preview

    def check(self, *parts: Array) -> None:
        """Raise UserError, naming it, for a part of another shape than these arrays have."""
        for name, own, part in zip(PARTS, self, parts, strict=True):
            if np.shape(part) != own.shape:
                raise UserError(f"control: {name} has shape {np.shape(part)}; it needs {own.shape}")


@inner
def instance_of(flat: Array, n: int, m: int, p: int) -> Instance:
    """Views of one array (n + 2 m + N p,)."""
    first = n + 2 * m
    preview = flat[first:].reshape(((flat.shape[0] - first) // p, p))
    return Instance(flat[:n], flat[n : n + m], flat[n + m : first], preview)


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction(Shared):
    """The model as compiled loops take it."""

    step: int
    """Address of one step, exact (:data:`~hybrid_sysid_ros.core.call.VALUE`)."""
    step_slopes: int
    """Of one step with its slopes, stick-slip rounded where there is a smoothing (:data:`~.call.SLOPES`)."""
    output: int
    """Of the output map."""
    output_slopes: int
    parameters: Array
    """(parameters,)."""
    network: Array
    """(weights,)."""
    h: float
    """Integration step [s]."""
    substeps: int
    """Of them in an interval."""
    smoothing: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon(Shared):
    """With an initial state e off, inputs v off and the trajectory's own gaps, the states at the end of interval i are
    off by free_i e + driven_i v + forced_i, the outputs there by C_i of that + D_i of the inputs.
    """

    states: Array
    """(N + 1, n)."""
    inputs: Array
    """(N, m)."""
    disturbance: Array
    """(m,) that it is linearised with."""
    outputs: Array
    """(N, p) at the end of each interval, for these states and inputs."""
    A: Array
    """(N, n, n), derivative of an interval's end by its beginning."""
    B: Array
    """(N, n, m), by its inputs."""
    C: Array
    """(N, p, n), of the outputs by the states at the end."""
    D: Array
    """(N, p, m), by the inputs of the interval."""
    reached: Array
    """(N, n), where each interval ends."""
    free: Array
    """(N, n, n)."""
    driven: Array
    """(N, n, v)."""
    forced: Array
    """(N, n)."""
    seen: Array
    """(N, p, v), derivative of the outputs by all inputs."""
    weights: StageWeights
    low: Array
    """(m,), bounds of the inputs."""
    high: Array
    """(m,)."""
    rate: Array
    """(m,), of their changes."""
    rated: NDArray[np.int64]
    """Inputs whose changes are limited: N rows each in the quadratic program."""
    bounded: NDArray[np.int64]
    """States with bounds: N rows each after those."""
    step: Array
    """(N, m), the last step of the inputs."""
    moved: Array
    """(N + 1, n), of the states."""
    simulated: Array
    """(N + 1, n), where a plan leads in the exact form."""
    adjoint: Array
    """(N + 1, n), how the Lagrangian changes with each state; of the initial state first."""
    curvature: Array
    """(N, n + m, n + m), of each interval's end, weighed by its adjoint, by its state and inputs."""
    before: Array
    """(N, n + 1, n + m), [A, B] of each interval at the iterate before, and its state and inputs there."""
    progress: Array
    """(3,) of a solution: steps made, the residual before the last one, and whether the curvature is taken in."""
    planned: Array
    """(N, m), the inputs of the plan, within all limits."""
    kept_states: Array
    """(N + 1, n), the trajectory before a solution, for where there is none."""
    kept_inputs: Array
    """(N, m)."""
    kept_disturbance: Array
    """(m,)."""
    work: Array
    """(6, n + p, n + m), of linearisations."""


def prediction(system: System, problem: Problem) -> Prediction:
    """The model of a problem, compiled once for each form of system (some seconds) and kept on disk."""
    functions = compiled(system)
    return Prediction(
        step=functions.step,
        step_slopes=functions.slopes(smooth=problem.smoothing > 0.0)[0],
        output=functions.output,
        output_slopes=functions.slopes(output=True)[0],
        parameters=system.values,
        network=np.ascontiguousarray(system.weights, dtype=float),
        h=problem.period / problem.substeps,
        substeps=problem.substeps,
        smoothing=problem.smoothing,
    )


def new_instance(system: System, problem: Problem) -> tuple[Array, Instance]:
    """An instance of zeros: one array, and its views."""
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    flat = np.zeros(n + 2 * m + problem.horizon * p)
    return flat, instance_of(flat, n, m, p)


def new_horizon(system: System, problem: Problem) -> Horizon:
    """The memory of a problem that is sized."""
    n, m, p, count = len(system.states), len(system.inputs), len(system.outputs), problem.horizon
    weights, rate = problem.weights, np.array(problem.rate_limits)
    shapes: list[tuple[tuple[int, ...], str]] = [
        ((count + 1, n), "states moved simulated adjoint kept_states"),
        ((count, m), "inputs step planned kept_inputs"),
        ((m,), "disturbance kept_disturbance"),
        ((count, p), "outputs"),
        ((count, n, n), "A free"),
        ((count, n, m), "B"),
        ((count, p, n), "C"),
        ((count, p, m), "D"),
        ((count, n), "reached forced"),
        ((count, n, count * m), "driven"),
        ((count, p, count * m), "seen"),
        ((count, n + m, n + m), "curvature"),
        ((count, n + 1, n + m), "before"),
        ((3,), "progress"),
        ((6, n + p, n + m), "work"),
    ]
    return Horizon(
        weights=weights,
        low=np.array(problem.input_low),
        high=np.array(problem.input_high),
        rate=rate,
        rated=np.flatnonzero(np.isfinite(rate)),
        bounded=np.flatnonzero(np.isfinite(weights.low) | np.isfinite(weights.high)),
        **{name: np.zeros(shape) for shape, names in shapes for name in names.split()},  # type: ignore[arg-type]
    )
