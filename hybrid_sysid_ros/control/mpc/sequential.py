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
    condense_rows,
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
from hybrid_sysid_ros.control.mpc.forms import condense_hessian
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.limits import clamp_inputs
from hybrid_sysid_ros.control.mpc.line_search import RISE, look_along, search_along
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, follow, keep_hard, linearise
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program
from hybrid_sysid_ros.control.stage_cost import is_squared
from hybrid_sysid_ros.core.call import pointer
from hybrid_sysid_ros.core.compilation import inner

SLOW = 0.1
"""Ratio of residuals above which a Gauss-Newton step is slow; after a slow step the curvature of the dynamics is used.
"""

STALLED, PATIENCE = 0.5, 8
"""Ratio of residuals above which a step with curvature has stalled, and number of steps before this counts."""

DOUBT = 0.05
"""Share of what a step changes in the stages' costs by which the cost of the simulated plan may exceed the cost that
its linear model predicts. A share of the cost itself would depend on constants in it, which move no plan.
"""

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
        condense_rows(horizon, program)
        evaluate_program(horizon, program, instance, False)
        error, made = residual(program), progress.steps
        if made + done > 0 and error <= tolerance:
            return SolverResult(True, done, error)
        if done == iterations:
            progress.residual = last
            return SolverResult(False, done, error)
        condense_hessian(horizon, program)
        _find_hessian(prediction, horizon, program, instance, error, last)
        if not _solve_program(horizon, program):
            return SolverResult(False, 0, error)
        progress.changed = quadratic.keep_working_set(program)
        if made + done == 0 and _is_solution(program, cost, tolerance):
            return SolverResult(True, 1, residual(program))
        cost = search_along(prediction, horizon, program, instance, cost, made == 0, True)
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
    expected = change = 0.0
    if judged:
        expected, change = expand(horizon, program, instance)
    search_along(prediction, horizon, program, instance, cost, True, False)
    horizon.progress[0].steps = 1
    if judged:
        foreseen(horizon, expected, change, simulated_cost(prediction, horizon, instance))
    return SolverResult(False, 1, np.inf)


@inner
def foreseen(horizon: Horizon, expected: float, change: float, found: float) -> bool:
    """Whether a simulated plan costs what its linear model predicts, see :func:`_as_expected`. How often in a row that
    was so is counted, and the cost kept.
    """
    progress = horizon.progress[0]
    progress.cost = found
    progress.foreseen = progress.foreseen + 1 if _as_expected(expected, change, found) else 0
    return progress.foreseen > 0  # type: ignore[no-any-return]


@inner
def _as_expected(expected: float, change: float, found: float) -> bool:
    """J <= J_expected + DOUBT sum |change of a stage's cost|, but for rounding."""
    return found <= expected + DOUBT * change + RISE * abs(expected)


@inner
def _begin(prediction: PredictionModel, horizon: Horizon, instance: Instance, anew: bool) -> float:
    """Linearise around the inputs from the instance's state on; return the cost there."""
    assign(horizon.states[0], instance.state)
    assign(horizon.disturbance, instance.disturbance)
    clamp_inputs(horizon, instance.previous, horizon.inputs, True)
    progress = horizon.progress[0]
    progress.cost = np.nan
    if anew:
        progress.steps, progress.residual, progress.with_curvature, progress.changed = 0, 0.0, False, 0
    look_along(prediction, horizon, instance, True)
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
        expected, change = make_step(prediction, horizon, program, instance)
        found = simulated_cost(prediction, horizon, instance)
        done += 1
        uphill = 0 if found <= cost else uphill + 1
        if uphill == 0:
            cost = found
            assign_rows(horizon.inputs, horizon.planned)
            if _as_expected(expected, change, found):
                break
        linearise(prediction, horizon, prediction.smoothing, False)
    assign_rows(horizon.planned, horizon.inputs)
    look_along(prediction, horizon, instance, True)
    return cost_of(horizon, instance), done


@inner
def make_step(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance
) -> tuple[float, float]:
    """Make the whole step of a solution, in the states by their linear prediction and to the instance's disturbance;
    return what :func:`expand` does.
    """
    expected, change = expand(horizon, program, instance)
    apply_step(horizon, 1.0)
    assign(horizon.disturbance, instance.disturbance)
    if horizon.limits.hard.any():
        keep_hard(prediction, horizon, instance.previous, horizon.inputs)
    return expected, change


@inner
def simulated_cost(prediction: PredictionModel, horizon: Horizon, instance: Instance) -> float:
    """The cost of the inputs when they are simulated."""
    found, _ = follow(prediction, horizon.weights, instance, horizon.inputs, horizon.simulated)
    return found  # type: ignore[no-any-return]


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
def _is_solution(program: Program, cost: float, tolerance: float) -> bool:
    """Whether the iterate itself is a solution: with the multipliers of its program its KKT residual is within the
    tolerance, and the step to the active constraints is worth no more than rounding of the cost.

    The step may still be long where the Gauss-Newton Hessian is nearly flat, and lead away from the solution.
    """
    v, worth = program.gradient.shape[0], 0.0
    for c in range(v):
        worth += abs(program.multipliers[c] * program.solution[c])
    for r in range(program.rows.shape[0]):
        moved = 0.0
        for c in range(v if program.multipliers[v + r] != 0.0 else 0):
            moved += program.rows[r, c] * program.solution[c]
        worth += abs(program.multipliers[v + r] * moved)
    return worth <= RISE * abs(cost) and residual(program) <= tolerance  # type: ignore[no-any-return]


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
