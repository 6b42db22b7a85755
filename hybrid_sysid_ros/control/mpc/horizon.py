"""The memory of one horizon: the instance, the prediction model, a trajectory and the problem linearised around it.

N = horizon, n = states, m = inputs, p = outputs, r = values of a stage: outputs and terms, v: all inputs in a row, u_0
first, but once for each block of intervals through which they are held.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.stage_cost import StageWeights
from hybrid_sysid_ros.core import System, compiled, trace
from hybrid_sysid_ros.core.chain_rule import padded
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array, aligned
from hybrid_sysid_ros.support.errors import UserError

PARTS = ("state", "disturbance", "previous_input", "preview")
"""Parts of an instance, by the arguments of :meth:`~hybrid_sysid_ros.control.controller.Controller.control`."""


class Instance(NamedTuple):
    """The data that change from call to call; as one array [x, d, u_previous, q_1, ..., q_N]."""

    state: Array
    """State when the inputs act, (n,)."""
    disturbance: Array
    """Offset of the inputs, (m,)."""
    previous: Array
    """Previous inputs, (m,)."""
    preview: Array
    """Reference of the outputs at the end of each interval, (N, p)."""

    def assign(self, *parts: Array) -> None:
        """Copy an instance into these arrays. Raises UserError for a part of another shape, naming it."""
        for name, own, part in zip(PARTS, self, parts, strict=True):
            shape = part.shape if isinstance(part, np.ndarray) else np.shape(part)
            if shape != own.shape:
                raise UserError(f"control: {name} has shape {shape}; it needs {own.shape}")
            own[:] = part


@inner
def instance_of(flat: Array, n: int, m: int, p: int) -> Instance:
    """Views of one array (n + 2 m + N p,)."""
    first = n + 2 * m
    preview = flat[first:].reshape(((flat.shape[0] - first) // p, p))
    return Instance(flat[:n], flat[n : n + m], flat[n + m : first], preview)


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictionModel(Shared):
    """The model for compiled loops."""

    step: int
    """Address of one step, exact (:data:`~hybrid_sysid_ros.core.call.VALUE`)."""
    smooth_step: int
    """Address of one where stick-slip is rounded by the smoothing."""
    step_jacobian: int
    """Address of such a step with derivatives (:data:`~.call.JACOBIAN`), which goes on from those of its state, see
    :meth:`~hybrid_sysid_ros.core.compiled.Compiled.jacobian`.
    """
    output: int
    """Address of the values of a stage: the outputs, and the terms behind them."""
    output_jacobian: int
    curvature: int
    """Address of the second derivatives of a sum of these (:class:`~hybrid_sysid_ros.core.stage_values.StageValues`); 0
    where there are no terms, or all are zero.
    """
    staged: int
    """Whether there are terms: the values' arguments then are those of :func:`~.linearisation.set_stage`."""
    stage: Array
    """Parameters of each stage, (N, q); empty where there are no terms."""
    parameters: Array
    """(parameters,)."""
    network: Array
    """(weights,)."""
    h: float
    """Integration step [s]."""
    substeps: int
    """Number of integration steps in an interval."""
    smoothing: float


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonTrajectory(Shared):
    """A trajectory, and its input disturbance."""

    states: Array
    """(N + 1, n)."""
    inputs: Array
    """(N, m)."""
    disturbance: Array
    """(m,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InputLimits(Shared):
    """Bounds of inputs and of their changes, and the rows of the quadratic program for changes and states."""

    low: Array
    """(m,)."""
    high: Array
    """(m,)."""
    rate: Array
    """Largest changes, (m,)."""
    moves: NDArray[np.int64]
    """Number of the block of each interval, (N,): inputs are held through a block."""
    rated: NDArray[np.int64]
    """Inputs whose changes are limited, (R,)."""
    bounded: NDArray[np.int64]
    """States with bounds, (S,)."""
    values: NDArray[np.int64]
    """Values with bounds, (V,)."""
    hard: NDArray[np.bool_]
    """Whether those bounds hold without exception, (V,)."""
    rate_rows: NDArray[np.int64]
    """Rows of the quadratic program, (R, N); -1: none, as without a bound or within a block."""
    state_rows: NDArray[np.int64]
    """(S, N)."""
    value_rows: NDArray[np.int64]
    """(V, N)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonLinearisation(Shared):
    """The model along a trajectory: x_{i+1} = reached_i + A_i dx + B_i du, values_i = outputs_i + C_i dx + D_i du."""

    reached: Array
    """States at the end of each interval, (N, n)."""
    outputs: Array
    """(N, r) at the end of each interval."""
    A: Array
    """Derivative of an interval's final state by its initial state, (N, n, n)."""
    B: Array
    """Derivative of an interval's final state by its inputs, (N, n, m)."""
    C: Array
    """Derivative of the values by the states at the end, (N, r, n)."""
    D: Array
    """Derivative of the values by the inputs of the interval, (N, r, m)."""
    response: Array
    """Derivative of the states at the end of each interval by all inputs, (N, n, padded v)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolutionStep(Shared):
    """The last step of a solution."""

    inputs: Array
    """(N, m)."""
    states: Array
    """(N + 1, n)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lagrangian(Shared):
    """Second derivatives of the dynamics in the Lagrangian, and the data of their update."""

    adjoint: Array
    """Derivative of the Lagrangian by each state, the initial one first, (N + 1, n)."""
    curvature: Array
    """Second derivatives of each interval's end by its state and inputs, weighted by its adjoint, (N, n + m, n + m)."""
    bend: Array
    """Second derivatives by the states at an interval's end and its inputs, (N, n + m, n + m): Gauss-Newton's of the
    cost, then those of the values, weighted by their factors in the Lagrangian.
    """
    kept: Array
    """Those of ``curvature`` while the Hessian is made convex, (N, n + m, n + m)."""
    jacobian: Array
    """[A, B] of each interval at the previous iterate, (N, n, n + m)."""
    point: Array
    """State and inputs of each interval at the previous iterate, (N, n + m)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Work(Shared):
    """Scratch memory of the linearisation of one interval, and of condensing."""

    total: Array
    """[A, B] up to a step of the interval, and below [0, I], (n + m, padded)."""
    ahead: Array
    """(n, padded), of all that follows on an interval's end, by its beginning."""
    form: Array
    """(n + m, padded), of all that follows on an interval's beginning."""
    slopes: Array
    """(r, n + arguments), of the values."""
    state: Array
    """(n,)."""
    drive: Array
    """(arguments,), inputs with the disturbance, and where there are terms the parameters of a stage, the disturbance
    and the values' factors in the Lagrangian.
    """
    following: Array
    """(n,)."""


PROGRESS = np.dtype(
    [
        ("steps", "i8"),
        ("changed", "i8"),
        ("foreseen", "i8"),
        ("residual", "f8"),
        ("cost", "f8"),
        ("with_curvature", "?"),
    ]
)
"""Progress of a solution: steps made, how many constraints came into the last step's working set or left it, how many
real-time steps in a row cost what was predicted, the residual before the last step, the cost of the newest real-time
step, NaN where that was not simulated, and whether curvature is used.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon(Shared):
    """The trajectory, the problem linearised about it, and the plan."""

    states: Array
    """(N + 1, n)."""
    inputs: Array
    """(N, m)."""
    disturbance: Array
    """Input disturbance of the linearisation, (m,)."""
    last: HorizonTrajectory
    """The trajectory before a solution, which is restored where there is no solution."""
    planned: Array
    """Inputs of the plan within all limits, (N, m)."""
    simulated: Array
    """States of a plan, simulated in the exact form, (N + 1, n)."""
    weights: StageWeights
    limits: InputLimits
    linear: HorizonLinearisation
    step: SolutionStep
    lagrangian: Lagrangian
    progress: NDArray[np.void]
    """(1,) of :data:`PROGRESS`."""
    work: Work


def prediction(system: System, problem: ControlProblem) -> PredictionModel:
    """The model of a problem, compiled once for each form of system (some seconds) and cached on disk."""
    functions, values = compiled(system), compiled(problem.outputs_of(system))
    bending = problem.outputs_of(system, curvature=True)
    return PredictionModel(
        step=functions.step,
        smooth_step=functions.smooth_step if problem.smoothing > 0.0 else functions.step,
        step_jacobian=functions.jacobian(smooth=problem.smoothing > 0.0, through=True)[0],
        output=values.output,
        output_jacobian=values.jacobian(output=True)[0],
        curvature=compiled(bending).output if problem.terms and not trace.output_of(bending).result.is_zero() else 0,
        staged=int(bool(problem.terms)),
        stage=problem.stage_values if problem.terms else np.zeros((problem.horizon, 0)),
        parameters=system.values,
        network=aligned(np.asarray(system.weights, dtype=float)),
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
    weights, rate, moves = problem.weights, np.array(problem.rate_limits), problem.moves
    v = int(moves[-1] + 1) * m
    path = {"states": (count + 1, n), "inputs": (count, m)}
    r, arguments = weights.outputs.shape[1], len(problem.outputs_of(system).inputs)
    hard = np.array([False] * p + [term.hard for term in problem.terms])
    new, last = np.diff(moves, prepend=-1) > 0, np.diff(moves, append=moves[-1] + 1) > 0
    limited = np.isfinite(weights.value_low) | np.isfinite(weights.value_high)
    rows, total = [], 0
    for exists in (
        np.isfinite(rate) & new[:, None],
        np.isfinite(weights.low) | np.isfinite(weights.high),
        limited & (last[:, None] | ~hard),  # hard ones depend on the inputs of a block alone
    ):
        rows.append(np.where(exists.T, total + np.cumsum(exists.T).reshape(exists.T.shape) - 1, -1))
        total += np.count_nonzero(exists)
    rated, bounded, values = (np.flatnonzero((each >= 0).any(axis=1)) for each in rows)
    return Horizon(
        **_zeros(**path, disturbance=(m,), planned=(count, m), simulated=(count + 1, n)),
        last=HorizonTrajectory(**_zeros(**path, disturbance=(m,))),
        weights=weights,
        limits=InputLimits(
            low=np.array(problem.input_low),
            high=np.array(problem.input_high),
            rate=rate,
            moves=moves,
            rated=rated,
            bounded=bounded,
            values=values,
            hard=hard[values],
            rate_rows=rows[0][rated],
            state_rows=rows[1][bounded],
            value_rows=rows[2][values],
        ),
        linear=HorizonLinearisation(
            **_zeros(reached=(count, n), outputs=(count, r)),
            **_zeros(
                A=(count, n, n), B=(count, n, m), C=(count, r, n), D=(count, r, m), response=(count, n, padded(v))
            ),
        ),
        step=SolutionStep(**_zeros(**path)),
        lagrangian=Lagrangian(
            **_zeros(adjoint=(count + 1, n), curvature=(count, n + m, n + m)),
            **_zeros(bend=(count, n + m, n + m), kept=(count, n + m, n + m)),
            **_zeros(jacobian=(count, n, n + m), point=(count, n + m)),
        ),
        progress=np.zeros(1, PROGRESS),
        work=Work(
            **_zeros(total=(n + m, padded(n + m)), ahead=(n, padded(n + m)), form=(n + m, padded(n + m))),
            **_zeros(slopes=(r, n + arguments), state=(n,), drive=(arguments + r,), following=(n,)),
        ),
    )


def _zeros(**shapes: tuple[int, ...]) -> dict[str, Any]:
    return {name: np.zeros(shape) for name, shape in shapes.items()}
