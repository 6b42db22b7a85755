"""The memory of one horizon: what is asked, how the model predicts, a trajectory and the problem linearised about it.

N = horizon, n = states, m = inputs, p = outputs, v = N m: all inputs in a row, u_0 first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.problem import ControlProblem, StageWeights
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

    def assign(self, state: Array, disturbance: Array, previous: Array, preview: Array) -> None:
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
class PredictionModel(Shared):
    """The model as compiled loops take it."""

    step: int
    """Address of one step, exact (:data:`~hybrid_sysid_ros.core.call.VALUE`)."""
    step_jacobian: int
    """Of one step with its derivatives, stick-slip rounded where there is a smoothing (:data:`~.call.JACOBIAN`)."""
    output: int
    """Of the output map."""
    output_jacobian: int
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
class HorizonTrajectory(Shared):
    """A trajectory, and the input disturbance that it is of."""

    states: Array
    """(N + 1, n)."""
    inputs: Array
    """(N, m)."""
    disturbance: Array
    """(m,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InputLimits(Shared):
    """Bounds of the inputs and of their changes, and which rows of the quadratic program they and the states take."""

    low: Array
    """(m,)."""
    high: Array
    """(m,)."""
    rate: Array
    """(m,), of the changes."""
    rated: NDArray[np.int64]
    """Inputs whose changes are limited: N rows each in the quadratic program."""
    bounded: NDArray[np.int64]
    """States with bounds: N rows each after those."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonLinearisation(Shared):
    """The model along a trajectory: x_{i+1} = reached_i + A_i dx + B_i du, y_i = outputs_i + C_i dx + D_i du."""

    reached: Array
    """(N, n), where each interval ends."""
    outputs: Array
    """(N, p) at the end of each interval."""
    A: Array
    """(N, n, n), derivative of an interval's end by its beginning."""
    B: Array
    """(N, n, m), by its inputs."""
    C: Array
    """(N, p, n), of the outputs by the states at the end."""
    D: Array
    """(N, p, m), by the inputs of the interval."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CondensedHorizon(Shared):
    """The intervals in a row: the states at the end of interval i deviate from the trajectory by
    state_transition_i e + input_response_i v + defect_i for an initial state e off and inputs v off.
    """

    state_transition: Array
    """(N, n, n)."""
    input_response: Array
    """(N, n, v)."""
    defect: Array
    """(N, n), of the trajectory's own gaps."""
    output_sensitivity: Array
    """(N, p, v), derivative of the outputs by all inputs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolutionStep(Shared):
    """The last step of a solution."""

    inputs: Array
    """(N, m)."""
    states: Array
    """(N + 1, n)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lagrangian(Shared):
    """The second derivatives of the dynamics in the Lagrangian, and what they are updated from."""

    adjoint: Array
    """(N + 1, n), derivative of the Lagrangian by each state; by the initial state first."""
    curvature: Array
    """(N, n + m, n + m), of each interval's end, weighed by its adjoint, by its state and inputs."""
    jacobian: Array
    """(N, n, n + m), [A, B] of each interval at the iterate before."""
    point: Array
    """(N, n + m), the state and the inputs of each interval there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Work(Shared):
    """Scratch memory of the linearisation of one interval."""

    total: Array
    """(n, n + m), [A, B] up to a step of the interval."""
    moved: Array
    """(n, n + m), the same one step later."""
    derivatives: Array
    """(n + p, n + m), of one step, or of the outputs in the first p rows."""
    state: Array
    """(n,)."""
    drive: Array
    """(m,), inputs with the disturbance."""
    following: Array
    """(n,)."""


PROGRESS = np.dtype([("steps", np.int64), ("residual", np.float64), ("with_curvature", np.bool_)])
"""Of a solution: steps made, the residual before the last one, and whether the dynamics' curvature is taken in."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon(Shared):
    """The trajectory, the problem linearised about it, and the plan."""

    states: Array
    """(N + 1, n)."""
    inputs: Array
    """(N, m)."""
    disturbance: Array
    """(m,) that it is linearised with."""
    last: HorizonTrajectory
    """The trajectory before a solution, for where there is none."""
    planned: Array
    """(N, m), the inputs of the plan, within all limits."""
    simulated: Array
    """(N + 1, n), where a plan leads in the exact form."""
    weights: StageWeights
    limits: InputLimits
    linear: HorizonLinearisation
    condensed: CondensedHorizon
    step: SolutionStep
    lagrangian: Lagrangian
    progress: NDArray[np.void]
    """(1,) of :data:`PROGRESS`."""
    work: Work


def prediction(system: System, problem: ControlProblem) -> PredictionModel:
    """The model of a problem, compiled once for each form of system (some seconds) and kept on disk."""
    functions = compiled(system)
    return PredictionModel(
        step=functions.step,
        step_jacobian=functions.jacobian(smooth=problem.smoothing > 0.0)[0],
        output=functions.output,
        output_jacobian=functions.jacobian(output=True)[0],
        parameters=system.values,
        network=np.ascontiguousarray(system.weights, dtype=float),
        h=problem.period / problem.substeps,
        substeps=problem.substeps,
        smoothing=problem.smoothing,
    )


def new_instance(system: System, problem: ControlProblem) -> tuple[Array, Instance]:
    """An instance of zeros: one array, and its views."""
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    flat = np.zeros(n + 2 * m + problem.horizon * p)
    return flat, instance_of(flat, n, m, p)


def new_horizon(system: System, problem: ControlProblem) -> Horizon:
    """The memory of a problem that is sized."""
    n, m, p, count = len(system.states), len(system.inputs), len(system.outputs), problem.horizon
    weights, rate, v = problem.weights, np.array(problem.rate_limits), problem.horizon * len(system.inputs)
    path = {"states": (count + 1, n), "inputs": (count, m)}
    return Horizon(
        **_zeros(**path, disturbance=(m,), planned=(count, m), simulated=(count + 1, n)),
        last=HorizonTrajectory(**_zeros(**path, disturbance=(m,))),
        weights=weights,
        limits=InputLimits(
            low=np.array(problem.input_low),
            high=np.array(problem.input_high),
            rate=rate,
            rated=np.flatnonzero(np.isfinite(rate)),
            bounded=np.flatnonzero(np.isfinite(weights.low) | np.isfinite(weights.high)),
        ),
        linear=HorizonLinearisation(
            **_zeros(reached=(count, n), outputs=(count, p)),
            **_zeros(A=(count, n, n), B=(count, n, m), C=(count, p, n), D=(count, p, m)),
        ),
        condensed=CondensedHorizon(
            **_zeros(state_transition=(count, n, n), input_response=(count, n, v)),
            **_zeros(defect=(count, n), output_sensitivity=(count, p, v)),
        ),
        step=SolutionStep(**_zeros(**path)),
        lagrangian=Lagrangian(
            **_zeros(adjoint=(count + 1, n), curvature=(count, n + m, n + m)),
            **_zeros(jacobian=(count, n, n + m), point=(count, n + m)),
        ),
        progress=np.zeros(1, PROGRESS),
        work=Work(
            **_zeros(total=(n, n + m), moved=(n, n + m), derivatives=(n + p, n + m)),
            **_zeros(state=(n,), drive=(m,), following=(n,)),
        ),
    )


def _zeros(**shapes: tuple[int, ...]) -> dict[str, Any]:
    return {name: np.zeros(shape) for name, shape in shapes.items()}
