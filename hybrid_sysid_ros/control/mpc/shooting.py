"""Multiple shooting in compiled code: the problem of a model linearised about a trajectory, again and again.

Bock & Plitt (1984), IFAC World Congress; Gauss-Newton real-time iteration: Diehl et al. (2002), J. Process Control
12(4); Gros et al. (2020), Int. J. Control 93(1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import horizon as hz
from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.horizon import SECANTS, Horizon
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program, QuadraticProgram
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.adapters import kernels, linearisation, workspace
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

STEP_HALVINGS = 4
"""Times that a step may be halved in search of a lower merit."""

MEMORY = 3
"""Steps among which the highest merit is the one to get below: a few that rise are how fast convergence looks."""

SLOW = 0.2
"""Share of the residual that a good Gauss-Newton step leaves at most; from slower steps the Hessian learns."""


class Prediction(NamedTuple):
    """The model as compiled functions take it: parameters (named), network (weights,), step [s] and substeps of an
    interval. single: shooting once, each state being moved to where the interval before it ends.
    """

    parameters: Any
    network: Array
    step: float
    substeps: int
    single: bool


class Answer(NamedTuple):
    """solved: the KKT residual is within the tolerance. iterations: programs solved; 0 where none had a solution.
    residual: largest of the gradient of the Lagrangian, the gaps and the initial gap.
    """

    solved: bool
    iterations: int
    residual: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Shooting:
    """The memory of one horizon and its compiled functions, which take it as their first arguments.

    prepare(model, horizon, program): linearise and condense about the trajectory.
    solve(model, horizon, program, question, iterations, tolerance, anew): prepare and step until solved; an
    :class:`Answer`. anew: forget what the Hessian learnt about the question before.
    begin(model, horizon, question): the input before, held, from the question's state.
    shift(model, horizon, fraction): the trajectory that much of an interval later.
    """

    model: Prediction
    horizon: Horizon
    program: Program
    memory: QuadraticProgram
    prepare: Callable[..., None]
    solve: Callable[..., Answer]
    begin: Callable[..., None]
    shift: Callable[..., None]


def shooting(system: System, problem: Problem) -> Shooting:
    """Make the memory and the functions; those are compiled once for each form of equation (some seconds).

    Raises UserError for equations of several inputs, and bounds that are not as many as the states.
    """
    if len(system.inputs) != 1:
        raise UserError(f"{type(system).__name__}: the MPC takes models of one input")
    count, states = problem.horizon, len(system.states)
    lower, upper = problem.bounds(states)
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    changes = count if np.isfinite(problem.rate_limit) else 0
    soft = np.arange(changes + count * len(bounded)) >= changes
    price = (problem.soft_linear / problem.output_scale, problem.soft_quadratic / problem.output_scale**2)
    memory = quadratic.quadratic_program(count, len(soft), soft_rows=soft, soft_weight=price)
    memory.program.rows[:changes] = np.eye(count)[:changes] - np.eye(count, k=-1)[:changes]
    horizon = Horizon(
        states=np.zeros((count + 1, states)),
        inputs=np.zeros(count),
        disturbance=np.zeros(1),
        A=np.zeros((count, states, states)),
        B=np.zeros((count, states, 1)),
        reached=np.zeros((count, states)),
        free=np.zeros((count, states, states)),
        driven=np.zeros((count, states, count)),
        forced=np.zeros((count, states)),
        output=system.measured[0],
        weights=problem.weights,
        input_limit=problem.input_limit,
        rate_limit=problem.rate_limit,
        bounded=bounded,
        lower=lower,
        upper=upper,
        price=np.array(price),
        step=np.zeros(count),
        moved=np.zeros((count + 1, states)),
        secants=np.zeros((2, SECANTS, count)),
        learnt=np.zeros(1, np.int64),
        rows=workspace(system),
    )
    model = Prediction(
        parameters=system.values,
        network=system.weights,
        step=problem.period / problem.substeps,
        substeps=problem.substeps,
        single=False,
    )
    functions = _compiled(system, problem.smoothing)
    return Shooting(model=model, horizon=horizon, program=memory.program, memory=memory, **functions)


_COMPILED: dict[Any, dict[str, Any]] = {}


def _compiled(system: System, smoothing: float) -> dict[str, Any]:
    """The functions that depend on the equation."""
    linearise = linearisation(system, smoothing=smoothing)
    if linearise in _COMPILED:
        return _COMPILED[linearise]
    advance = kernels(system).step

    @hz.inner
    def interval(model: Any, horizon: Any, i: int, drive: Array, x: Array, following: Array) -> None:
        """Where the exact form goes from state i with input i in one interval."""
        drive[0] = horizon.inputs[min(i, horizon.inputs.shape[0] - 1)] + horizon.disturbance[0]
        for a in range(x.shape[0]):
            x[a] = horizon.states[i, a]
        for _ in range(model.substeps):
            advance(x, drive, model.parameters, model.network, model.step, following)
            for a in range(x.shape[0]):
                x[a] = following[a]

    @hz.inner
    def prepare(model: Any, horizon: Any, program: Any) -> None:
        drive = np.empty(1)
        for i in range(horizon.inputs.shape[0]):
            drive[0] = horizon.inputs[i] + horizon.disturbance[0]
            linearise(
                horizon.states[i],
                drive,
                model.parameters,
                model.network,
                model.step,
                model.substeps,
                horizon.rows,
                horizon.reached[i],
                horizon.A[i],
                horizon.B[i],
            )
            if model.single:
                hz.assign(horizon.states[i + 1], horizon.reached[i])
        hz.condense(horizon, program)

    def begin(model: Any, horizon: Any, question: Any) -> None:
        count, states, limit = horizon.inputs.shape[0], question.state.shape[0], horizon.input_limit
        drive, x, following = np.empty(1), np.empty(states), np.empty(states)
        horizon.disturbance[0] = question.disturbance[0]
        for a in range(states):
            horizon.states[0, a] = question.state[a]
        for i in range(count):
            horizon.inputs[i] = min(max(question.previous[0], -limit), limit)
            interval(model, horizon, i, drive, x, following)
            for a in range(states):
                horizon.states[i + 1, a] = x[a]

    def shift(model: Any, horizon: Any, fraction: float) -> None:
        count, states = horizon.reached.shape
        drive, x, following = np.empty(1), np.empty(states), np.empty(states)
        interval(model, horizon, count, drive, x, following)
        for i in range(count):
            following_input = horizon.inputs[min(i + 1, count - 1)]
            horizon.inputs[i] = (1.0 - fraction) * horizon.inputs[i] + fraction * following_input
            for a in range(states):
                horizon.states[i, a] = (1.0 - fraction) * horizon.states[i, a] + fraction * horizon.states[i + 1, a]
        for a in range(states):
            horizon.states[count, a] = (1.0 - fraction) * horizon.states[count, a] + fraction * x[a]

    def solve(
        model: Any, horizon: Any, program: Any, question: Any, iterations: int, tolerance: float, anew: bool
    ) -> Answer:
        """Full steps, halved where the merit rises above that of the last few (Grippo et al. 1986)."""
        before = np.zeros(horizon.inputs.shape[0])
        hz.assign(horizon.states[0], question.state)
        hz.assign(horizon.disturbance, question.disturbance)
        merits = np.full(MEMORY, np.inf)
        penalty, residual, last, length, halvings, done = 0.0, np.inf, np.inf, 0.0, 0, 0
        learnt = 0 if anew else horizon.learnt[0]
        while True:
            prepare(model, horizon, program)
            cost, gap = hz.evaluate(horizon, program, question)
            residual = hz.residual(horizon, program, question)
            if done > 0 and residual <= tolerance:
                return Answer(True, done, residual)
            penalty = max(penalty, 2.0 * hz.steepest(horizon, question))
            merit = cost + penalty * gap
            if done > 0 and halvings < STEP_HALVINGS and not merit <= np.max(merits) + 1e-9 * abs(merit):
                halvings += 1
                length *= 0.5
                hz.move(horizon, -length)
                continue
            if done == iterations:
                return Answer(False, done, residual)
            if learnt == SECANTS:
                learnt = 0  # what was learnt far from here does more harm than good
            elif done > 1 and residual > SLOW * last:
                steps, changes = horizon.secants
                for j in range(before.shape[0]):
                    steps[learnt, j] = length * horizon.step[j]
                    changes[learnt, j] = program.gradient[j] - before[j]
                learnt += 1
            horizon.learnt[0] = learnt
            for k in range(learnt):
                hz.learn(program.hessian, horizon.secants[0, k], horizon.secants[1, k])
            hz.assign(before, program.gradient)
            last = residual
            if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
                if learnt == 0:
                    return Answer(False, 0, residual)
                learnt, last = 0, np.inf  # once more with nothing learnt, and this step is not to learn from either
                continue
            quadratic.remember(program)
            merits[done % MEMORY] = merit
            done += 1
            hz.expand(horizon, program, question)
            length, halvings = 1.0, 0
            hz.move(horizon, 1.0)

    _COMPILED[linearise] = {
        "prepare": numba.njit(prepare, **hz.OPTIONS),
        "begin": numba.njit(begin, **hz.OPTIONS),
        "shift": numba.njit(shift, **hz.OPTIONS),
        "solve": numba.njit(solve, **hz.OPTIONS),
    }
    return _COMPILED[linearise]
