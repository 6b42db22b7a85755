"""Sequential quadratic programming in the inputs of a horizon; the states are simulated at each iterate.

Tenny, Wright & Rawlings (2004), Computational Optimization and Applications 28 (feasible iterates); Nocedal & Wright
(2006), Numerical optimization, chapter 18. From a cold start states are variables at first: Albersmeyer & Diehl (2010),
The lifted Newton method, SIAM Journal on Optimization 20(3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.condensing import (
    apply_step,
    condense,
    correct_bounds,
    cost_of,
    evaluate_program,
    expand,
    find_adjoint,
    residual,
)
from hybrid_sysid_ros.control.mpc.curvature import (
    add_curvature,
    bend_values,
    find_curvature,
    keep_derivatives,
    update_curvature,
)
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.limits import clamp_inputs
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, follow, keep_hard, linearise, simulate
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program
from hybrid_sysid_ros.control.stage_cost import is_squared
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

RISE = 1e-8
"""Share of the cost by which a step may raise it: rounding, and along bounds that bend what is left of their violation
after a correction, which in flat directions exceeds all that a step gains.
"""

SMALL = 0.2
"""Largest correction of a step for bounds that bend, in steps: where it is larger, the iterate is far from a solution.
"""

HALVINGS = 8
"""Most halvings of a step in search of a cost that is not higher."""

SLOW = 0.1
"""Ratio of residuals above which a Gauss-Newton step is slow; after a slow step the curvature of the dynamics is used.
"""

STALLED, PATIENCE = 0.5, 8
"""Ratio of residuals above which a step with curvature has stalled, and number of steps before this counts."""

COARSE = 30.0
"""Factor of the smoothing for a second attempt at a first step that increased the cost: where everything sticks, the
derivatives by the inputs are nearly zero.
"""

DOUBT = 0.05
"""Share by which the cost of a simulated plan may exceed the cost that its linear model predicts."""

ASSURED = 10
"""Steps in a row whose cost was predicted, after which a program is prepared for the next one."""

LIFTED, UPHILL = 8, 2
"""Most steps that leave gaps, and number of them in a row that may lead to no lower cost."""


class SolverResult(NamedTuple):
    """The result of :func:`solve`."""

    solved: bool
    """Whether the KKT residual is within the tolerance."""
    iterations: int
    """Number of steps; 0 where a quadratic program had no solution."""
    residual: float
    """The largest entry of the gradient of the Lagrangian."""


@inner
def solve(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    instance: Instance,
    iterations: int,
    tolerance: float,
    anew: bool,
    cold: bool,
) -> SolverResult:
    """Iterate by Gauss-Newton, and where that is slow by Newton's method. anew: False continues the previous call.
    cold: the trajectory is no earlier plan.
    """
    progress = horizon.progress[0]
    cost, last, done = _begin(prediction, horizon, instance, anew), progress.residual, 0
    if cold and is_squared(horizon.weights):  # elsewhere Gauss-Newton's Hessian is not worth a step uphill
        cost, done = _lift(prediction, horizon, program, instance, cost, min(iterations, LIFTED))
    while True:
        condense(horizon, program)
        evaluate_program(horizon, program, instance, False)
        error, made = residual(program), progress.steps
        if made + done > 0 and error <= tolerance:
            return SolverResult(True, done, error)
        if done == iterations:
            progress.residual = last
            return SolverResult(False, done, error)
        _find_hessian(prediction, horizon, program, instance, error, last)
        if not _solve_program(horizon, program):
            return SolverResult(False, 0, error)
        quadratic.keep_working_set(program)
        cost = _search(prediction, horizon, program, instance, cost, made == 0, True)
        last = error
        progress.steps += 1
        done += 1


@inner
def improve(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, judged: bool
) -> SolverResult:
    """Make one step of :func:`solve`, whose end is simulated only: without derivatives its residual is not known.
    judged: find by :func:`foreseen` whether its cost was predicted.
    """
    cost = _begin(prediction, horizon, instance, True)
    condense(horizon, program)
    evaluate_program(horizon, program, instance, False)
    _find_hessian(prediction, horizon, program, instance, np.inf, np.inf)
    if not _solve_program(horizon, program):
        return SolverResult(False, 0, np.inf)
    quadratic.keep_working_set(program)
    expected = expand(horizon, program, instance) if judged else 0.0
    _search(prediction, horizon, program, instance, cost, True, False)
    horizon.progress[0].steps = 1
    if judged:
        found, _ = follow(prediction, horizon.weights, instance, horizon.inputs, horizon.simulated)
        foreseen(horizon, expected, found)
    return SolverResult(False, 1, np.inf)


@inner
def foreseen(horizon: Horizon, expected: float, found: float) -> bool:
    """Whether a simulated plan costs what its linear model predicts, J <= J_expected + DOUBT |J_expected|. How often in
    a row that was so is counted.
    """
    progress = horizon.progress[0]
    progress.foreseen = progress.foreseen + 1 if found <= expected + DOUBT * abs(expected) else 0
    return progress.foreseen > 0  # type: ignore[no-any-return]


@inner
def _begin(prediction: PredictionModel, horizon: Horizon, instance: Instance, anew: bool) -> float:
    """Linearise around the inputs from the instance's state on; return the cost there."""
    assign(horizon.states[0], instance.state)
    assign(horizon.disturbance, instance.disturbance)
    clamp_inputs(horizon, instance.previous, horizon.inputs, True)
    progress = horizon.progress[0]
    if anew:
        progress.steps, progress.residual, progress.with_curvature = 0, 0.0, False
    _look(prediction, horizon, True)
    return cost_of(horizon, instance)  # type: ignore[no-any-return]


@inner
def _lift(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, cost: float, most: int
) -> tuple[float, int]:
    """Make steps that move states by their linear prediction and leave gaps, until the best inputs so far cost what was
    predicted when they are simulated; else go back to the best ones. Return the cost and the number of steps.

    A whole step along bent dynamics often leads uphill and still nearer: Chamberlain, Powell, Lemarechal & Pedersen
    (1982), The watchdog technique, Mathematical Programming Study 16.
    """
    done = uphill = 0
    assign_rows(horizon.inputs, horizon.planned)
    while done < most and uphill < UPHILL:
        condense(horizon, program)
        evaluate_program(horizon, program, instance, True)
        _find_hessian(prediction, horizon, program, instance, np.inf, np.inf)
        if not _solve_program(horizon, program):
            break
        quadratic.keep_working_set(program)
        expected, found = make_step(prediction, horizon, program, instance)
        done += 1
        uphill = 0 if found <= cost else uphill + 1
        if uphill == 0:
            cost = found
            assign_rows(horizon.inputs, horizon.planned)
            if found <= expected + DOUBT * abs(expected):
                break
        linearise(prediction, horizon, prediction.smoothing, False)
    assign_rows(horizon.planned, horizon.inputs)
    _look(prediction, horizon, True)
    return cost_of(horizon, instance), done


@inner
def make_step(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance
) -> tuple[float, float]:
    """Make the whole step of a solution, in the states by their linear prediction; return the cost that it predicts,
    and that of the inputs when they are simulated.
    """
    expected = expand(horizon, program, instance)
    apply_step(horizon, 1.0)
    if horizon.limits.hard.any():
        keep_hard(prediction, horizon)
    found, _ = follow(prediction, horizon.weights, instance, horizon.inputs, horizon.simulated)
    return expected, found


@inner
def _look(prediction: PredictionModel, horizon: Horizon, derivatives: bool) -> None:
    """Find states and outputs for the inputs, with their derivatives or, at a third of the effort, without."""
    if horizon.limits.hard.any():
        keep_hard(prediction, horizon)
    if derivatives:
        linearise(prediction, horizon, prediction.smoothing, True)
    else:
        simulate(prediction, horizon)


@inner
def _solve_program(horizon: Horizon, program: Program) -> bool:
    """Solve the program, and where the solver goes round in circles once more without curvature, from an empty working
    set: far from the reference the Hessian can be so steep that its inverse is rounding alone.
    """
    if quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
        return True
    quadratic.clear_working_set(program)
    condense(horizon, program)
    return quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES)  # type: ignore[no-any-return]


@inner
def _find_hessian(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, error: float, last: float
) -> None:
    """Add the curvature of the dynamics to the Hessian where Gauss-Newton is slow: by updates from the steps, and where
    these are slow too, by differences.
    """
    progress = horizon.progress[0]
    if progress.steps == 0:
        curvature = pointer(horizon.lagrangian.curvature)
        for c in range(horizon.lagrangian.curvature.size):
            curvature[c] = 0.0
    bending = False
    if prediction.curvature != 0:
        bending = bend_values(prediction, horizon, program, instance)
        progress.with_curvature = progress.with_curvature or bending
    if progress.steps > 0:
        find_adjoint(horizon, program, instance)
        if progress.with_curvature and progress.steps > PATIENCE and error > STALLED * last:
            find_curvature(prediction, horizon)
        else:
            update_curvature(horizon)
        if error > SLOW * last:
            progress.with_curvature = True
    if progress.with_curvature:
        add_curvature(horizon, program, bending)
    keep_derivatives(horizon)


@inner
def _search(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, cost: float, first: bool,
    derivatives: bool,
) -> float:  # fmt: skip
    """Make the step of a solution, halved until the cost is not higher; return the new cost. derivatives: linearise
    there. Most steps end where they first lead, so only there derivatives are found before the cost is known.
    """
    length, halved, hard = 1.0, False, horizon.limits.hard.any()
    if hard:
        assign_rows(horizon.inputs, horizon.step.inputs)
    _step(horizon, program, 1.0)
    for halving in range(HALVINGS + 1):
        _look(prediction, horizon, derivatives and not halved)
        found = cost_of(horizon, instance)
        if found <= cost + RISE * abs(cost):
            break
        if (
            halving == 0
            and correct_bounds(horizon, program)
            and _corrected(prediction, horizon, program, instance, cost, derivatives)
        ):
            found = cost_of(horizon, instance)
            break
        halved = True
        if halving < HALVINGS:
            length *= 0.5
            if hard:
                assign_rows(horizon.step.inputs, horizon.inputs)
            _step(horizon, program, length if hard else -length)
        if first and halving == 1 and prediction.smoothing > 0.0:
            _step(horizon, program, -length)
            length = _coarse_step(prediction, horizon, program, instance)
    if halved and derivatives:
        linearise(prediction, horizon, prediction.smoothing, True)
    return found


@inner
def _corrected(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, cost: float,
    derivatives: bool,
) -> bool:  # fmt: skip
    """Replace the step by one for the bounds that were found at its end; False where that costs more, too, or leads
    elsewhere: then the step is as before. Nocedal & Wright (2006), section 15.6: without this correction the price of
    bounds that bend shortens all steps along them (Maratos).
    """
    v = program.solution.shape[0]
    step, multipliers = np.empty(v), np.empty(program.multipliers.shape[0])
    assign(step, program.solution)
    assign(multipliers, program.multipliers)
    sound = quadratic.solve(program, GRADIENT | BOUNDS | STATES)
    size = change = 0.0
    for c in range(v):
        size += step[c] * step[c]
        change += (program.solution[c] - step[c]) * (program.solution[c] - step[c])
    if sound and change <= SMALL * SMALL * size:
        _step(horizon, program, 1.0)
        _move(horizon, step, -1.0)
        _look(prediction, horizon, derivatives)
        if cost_of(horizon, instance) <= cost + RISE * abs(cost):
            quadratic.keep_working_set(program)
            return True
        _step(horizon, program, -1.0)
        _move(horizon, step, 1.0)
    assign(program.solution, step)
    assign(program.multipliers, multipliers)
    return False


@inner
def _coarse_step(prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance) -> float:
    """Make the step that results from a larger smoothing; return its length, 0 where there is none."""
    linearise(prediction, horizon, COARSE * prediction.smoothing, True)
    condense(horizon, program)
    evaluate_program(horizon, program, instance, False)
    if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
        return 0.0
    quadratic.keep_working_set(program)
    _step(horizon, program, 1.0)
    return 1.0


@inner
def _step(horizon: Horizon, program: Program, length: float) -> None:
    """Move the inputs along the solution."""
    _move(horizon, program.solution, length)


@inner
def _move(horizon: Horizon, step: Array, length: float) -> None:
    """Move the inputs along a step (v,)."""
    count, m = horizon.inputs.shape
    for i in range(count):
        for j in range(m):
            horizon.inputs[i, j] += length * step[horizon.limits.moves[i] * m + j]
