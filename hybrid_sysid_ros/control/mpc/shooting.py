"""Multiple shooting in compiled code: the problem of a model linearised about a trajectory, again and again.

Bock & Plitt (1984), IFAC World Congress; Gauss-Newton real-time iteration: Diehl et al. (2002), J. Process Control
12(4); Gros et al. (2020), Int. J. Control 93(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.condensing import (
    assign,
    condense,
    cut,
    evaluate,
    expand,
    find_adjoint,
    move,
    residual,
)
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, Prediction, new_horizon, prediction
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program, QuadraticProgram
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.control.stage_cost import StageWeights, excess, stage_cost
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.call import call_slopes, call_value, pointer
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

STEP_HALVINGS = 4
"""Times that a step may be halved in search of a lower merit."""

MEMORY = 3
"""Steps among which the highest merit is the one to get below: a few that rise are how fast convergence looks."""

SLOW = 0.2
"""Share of the residual that a good Gauss-Newton step leaves at most; from slower steps the Hessian is updated."""


class SolverResult(NamedTuple):
    """What :func:`solve` found."""

    solved: bool
    """The KKT residual is within the tolerance."""
    iterations: int
    """Quadratic programs solved; 0 where one had no solution."""
    residual: float
    """Largest of the gradient of the Lagrangian, the gaps and the initial gap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shooting:
    """The memory of one horizon: what the compiled functions here take."""

    prediction: Prediction
    horizon: Horizon
    program: Program
    memory: QuadraticProgram


def shooting(system: System, problem: Problem) -> Shooting:
    """Make the memory.

    Raises UserError for a problem of other numbers of inputs, outputs or states, and for inputs of different delays.
    """
    problem = problem.sized(system)
    one_delay(system, problem)
    horizon, count, m = new_horizon(system, problem), problem.horizon, len(system.inputs)
    v = count * m
    hard, soft = count * len(horizon.rated), count * len(horizon.bounded)
    memory = quadratic.quadratic_program(
        v,
        hard + soft,
        soft_rows=np.arange(hard + soft) >= hard,
        soft_linear=np.concatenate([np.zeros(hard), np.repeat(horizon.weights.linear[horizon.bounded], count)]),
        soft_quadratic=np.concatenate([np.ones(hard), np.repeat(horizon.weights.quadratic[horizon.bounded], count)]),
    )
    for r, j in enumerate(horizon.rated):
        for i in range(count):
            memory.program.rows[r * count + i, i * m + j] = 1.0
            if i > 0:
                memory.program.rows[r * count + i, (i - 1) * m + j] = -1.0
    return Shooting(prediction=prediction(system, problem), horizon=horizon, program=memory.program, memory=memory)


def one_delay(system: System, problem: Problem) -> None:
    """Raise UserError for inputs whose delays differ by more than half an integration step: a controller is given the
    state that all its inputs will meet.
    """
    delays = system.input_delays
    if np.ptp(delays) > 0.5 * problem.period / problem.substeps:
        raise UserError(
            f"{type(system).__name__}: its inputs have different delays, {delays.tolist()} s; the MPC needs one for all: "
            "delay the faster inputs as much"
        )


# ---------------------------------------------------------------------- prediction


@inner
def _advance(prediction: Prediction, x: Array, drive: Array, following: Array) -> None:
    """X (n,) one interval on, in the exact form."""
    for _ in range(prediction.substeps):
        call_value(prediction.step, x, drive, prediction.parameters, prediction.network, prediction.h, 0.0, following)
        assign(x, following)


@inner
def _linearise(prediction: Prediction, horizon: Horizon, i: int) -> None:
    """Where interval i leads to from the trajectory's state and inputs, its outputs, and A, B, C, D."""
    n, m = horizon.B.shape[1:]
    p, w, h, s = prediction.parameters, prediction.network, prediction.h, prediction.smoothing
    total, moved, slopes, x, drive = (
        horizon.work[0],
        horizon.work[1],
        horizon.work[2],
        horizon.work[3, 0],
        horizon.work[4, 0],
    )
    following = horizon.reached[i]
    for a in range(n):
        x[a] = horizon.states[i, a]
    for j in range(m):
        drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]
    call_slopes(prediction.step_slopes, x, drive, p, w, h, s, following, total)
    for _ in range(prediction.substeps - 1):
        for a in range(n):
            x[a] = following[a]
        call_slopes(prediction.step_slopes, x, drive, p, w, h, s, following, slopes)
        _chain(slopes, total, moved, n, m)
        total, moved = moved, total
    for a in range(n):
        for b in range(n):
            horizon.A[i, a, b] = total[a, b]
        for j in range(m):
            horizon.B[i, a, j] = total[a, n + j]


@inner
def _chain(slopes: Array, total: Array, moved: Array, n: int, m: int) -> None:
    """Moved = slopes_x total + [0, slopes_u], all (n, n + m)."""
    width = n + m
    f, t, o = pointer(slopes), pointer(total), pointer(moved)
    for a in range(n):
        for c in range(width):
            change = f[a * width + c] if c >= n else 0.0
            for b in range(n):
                change += f[a * width + b] * t[b * width + c]
            o[a * width + c] = change


@inner
def _observe(prediction: Prediction, horizon: Horizon, i: int) -> None:
    """The outputs at the end of interval i, and C and D."""
    n, m = horizon.B.shape[1:]
    slopes, drive = horizon.work[2], horizon.work[4, 0]
    for j in range(m):
        drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]
    call_slopes(
        prediction.output_slopes, horizon.states[i + 1], drive, prediction.parameters, prediction.network,
        prediction.h, 0.0, horizon.outputs[i], slopes,
    )  # fmt: skip
    for k in range(horizon.outputs.shape[1]):
        for b in range(n):
            horizon.C[i, k, b] = slopes[k, b]
        for j in range(m):
            horizon.D[i, k, j] = slopes[k, n + j]


@inner
def linearise(prediction: Prediction, horizon: Horizon, single: bool) -> None:
    """All intervals. single: shooting once, each state being moved to where the interval before it ends."""
    for i in range(horizon.inputs.shape[0]):
        _linearise(prediction, horizon, i)
        if single:
            assign(horizon.states[i + 1], horizon.reached[i])
        _observe(prediction, horizon, i)


@kernel
def linearised(prediction: Prediction, horizon: Horizon) -> None:
    """A, B, C, D, reached and outputs about the trajectory."""
    linearise(prediction, horizon, False)


# ---------------------------------------------------------------------- trajectories


@kernel
def cold_start(prediction: Prediction, horizon: Horizon, instance: Instance) -> None:
    """The trajectory of the inputs before, held."""
    count, m = horizon.inputs.shape
    drive, x, following = np.empty(m), instance.state.copy(), np.empty(instance.state.shape[0])
    assign(horizon.disturbance, instance.disturbance)
    assign(horizon.states[0], x)
    for i in range(count):
        for j in range(m):
            horizon.inputs[i, j] = min(max(instance.previous[j], horizon.low[j]), horizon.high[j])
            drive[j] = horizon.inputs[i, j] + horizon.disturbance[j]
        _advance(prediction, x, drive, following)
        assign(horizon.states[i + 1], x)


@kernel
def shift(prediction: Prediction, horizon: Horizon, fraction: float) -> None:
    """The trajectory that much of an interval later."""
    count, n = horizon.reached.shape
    m = horizon.inputs.shape[1]
    drive, x, following = np.empty(m), horizon.states[count].copy(), np.empty(n)
    for j in range(m):
        drive[j] = horizon.inputs[count - 1, j] + horizon.disturbance[j]
    _advance(prediction, x, drive, following)
    for i in range(count + 1):
        for a in range(n):
            after = x[a] if i == count else horizon.states[i + 1, a]
            horizon.states[i, a] = (1.0 - fraction) * horizon.states[i, a] + fraction * after
        if i < count - 1:
            for j in range(m):
                horizon.inputs[i, j] = (1.0 - fraction) * horizon.inputs[i, j] + fraction * horizon.inputs[i + 1, j]


@kernel
def rollout(
    prediction: Prediction, weights: StageWeights, instance: Instance, inputs: Array, states: Array
) -> tuple[float, float]:
    """Simulate inputs (N, m) in the exact form into ``states`` (N + 1, n); their cost, and by how much a state is
    outside of its bounds at most.
    """
    n, m = instance.state.shape[0], inputs.shape[1]
    drive, x, following = np.empty(m), instance.state.copy(), np.empty(n)
    y = np.empty(instance.preview.shape[1])
    cost = largest = 0.0
    assign(states[0], x)
    for i in range(inputs.shape[0]):
        for j in range(m):
            drive[j] = inputs[i, j] + instance.disturbance[j]
        _advance(prediction, x, drive, following)
        call_value(prediction.output, x, drive, prediction.parameters, prediction.network, prediction.h, 0.0, y)
        assign(states[i + 1], x)
        before = instance.previous if i == 0 else inputs[i - 1]
        cost += stage_cost(weights, i, y, instance.preview[i], inputs[i], before, x)
        for a in range(n):
            largest = max(largest, excess(weights, a, x[a]))
    return cost, largest


@kernel
def forget(horizon: Horizon, program: Program) -> None:
    """Forget what is left in the memory of the problem solved last, but for the trajectory."""
    quadratic.clear_working_set(program)
    horizon.bend[:] = 0.0


@kernel
def bounded(horizon: Horizon, previous: Array, inputs: Array) -> None:
    """Cut inputs (N, m) to their bounds and rate limits after ``previous`` (m,)."""
    cut(horizon, previous, inputs)


# ---------------------------------------------------------------------- the two phases of a real-time iteration


@kernel
def prepare(prediction: Prediction, horizon: Horizon, program: Program) -> None:
    """The preparation phase: linearise and condense about the trajectory."""
    linearise(prediction, horizon, False)
    condense(horizon, program)


@kernel
def feedback(horizon: Horizon, program: Program, instance: Instance) -> bool:
    """The feedback phase: the step from what was prepared, its matrices factorised.

    False where the program has no solution; the trajectory then stays.
    """
    evaluate(horizon, program, instance)
    if not quadratic.solve(program, GRADIENT | BOUNDS | STATES):
        return False
    quadratic.keep_working_set(program)
    expand(horizon, program, instance)
    move(horizon, 1.0)
    assign(horizon.disturbance, instance.disturbance)
    return True


# ---------------------------------------------------------------------- sequential quadratic programming


@kernel
def solve(
    prediction: Prediction,
    horizon: Horizon,
    program: Program,
    instance: Instance,
    iterations: int,
    tolerance: float,
    anew: bool,
) -> SolverResult:
    """Prepare and step until solved: full steps, halved where the merit rises above that of the last few (Grippo et al.
    1986). anew: forget the updates of the Hessian that were made for the instance before.
    """
    assign(horizon.states[0], instance.state)
    assign(horizon.disturbance, instance.disturbance)
    merits = np.full(MEMORY, np.inf)
    penalty, error, length, halvings, done = 0.0, np.inf, 0.0, 0, 0
    while True:
        linearise(prediction, horizon, False)
        condense(horizon, program)
        cost, gap = evaluate(horizon, program, instance)
        error = residual(horizon, program, instance)
        if done > 0 and error <= tolerance:
            return SolverResult(True, done, error)
        penalty = max(penalty, 2.0 * find_adjoint(horizon, program, instance))
        merit = cost + penalty * gap
        if done > 0 and halvings < STEP_HALVINGS and not merit <= np.max(merits) + 1e-9 * abs(merit):
            halvings += 1
            length *= 0.5
            move(horizon, -length)
            continue
        if done == iterations:
            return SolverResult(False, done, error)
        if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
            return SolverResult(False, 0, error)
        quadratic.keep_working_set(program)
        merits[done % MEMORY] = merit
        done += 1
        expand(horizon, program, instance)
        length, halvings = 1.0, 0
        move(horizon, 1.0)
