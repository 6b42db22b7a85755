"""Least squares on compiled rollouts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from threadpoolctl import threadpool_limits

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.identification.condensed_residuals import CondensedResiduals
from hybrid_sysid_ros.identification.experiment import check_range
from hybrid_sysid_ros.identification.known_errors import known_errors, lag_of_sensors
from hybrid_sysid_ros.identification.problem import FitProblem, Map
from hybrid_sysid_ros.identification.shooting import MultipleShootingProblem, UnstableFitSettings
from hybrid_sysid_ros.identification.standard_errors import block_spread, confidence, covariances, secant_jacobian
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.support import threads
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Biased(Wrapper):
    """x' = f(x, u + S b),  b' = 0: a state b for each input, which no record shows and whose value each record has.

    A fit's initial states are nuisances with priors, and so is b, in units of its prior deviation S.
    """

    spreads: tuple[float, ...]
    """S, prior deviations of the biases in the inputs' units, (inputs,)."""

    @property
    def added_states(self) -> tuple[Variable, ...]:
        return tuple(Variable(name=f"bias_{item.name}", unit="") for item in self.inputs)

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        biases = x[self._physical :]
        return [value + spread * b for value, spread, b in zip(u, self.spreads, biases, strict=False)]

    def biases(self, nuisances: Mapping[str, Array]) -> dict[str, Array]:
        """Bias of each input in each record, (records,) in its unit, from the fitted corrections of initial states."""
        return {
            item.name: spread * nuisances[f"bias_{item.name}"]
            for item, spread in zip(self.inputs, self.spreads, strict=True)
        }

    def record_map(self) -> RecordMap:
        """The record map of the physics, with the biases among the unobserved states."""
        at = range(self._physical, self._physical + len(self.inputs))
        return replace(super().record_map(), unobserved=[*self.physics.record_map().unobserved, *at])


FitProgress = Callable[[str, int, float], None]
"""progress(stage, evaluations, root mean square error relative to the output's deviation)"""

STAGES: tuple[int | None, ...] = (20, 60, 200, None)
"""Samples of the rollouts in each stage; None: the whole record. Short rollouts first keep the cost nearly convex."""

ANCHOR = 3.0
"""Prior deviation of an anchored parameter, in standard deviations of the earlier fit's cost."""

ITERATIONS, COARSE, FINE = 40, 1e-3, 1e-6
"""Limits of each stage. The last stage of a physical structure is fine, since its parameters have a meaning; a network
that is stopped early predicts unseen records as well, in half the time."""

REWEIGHTED, WORTHWHILE, MOST_CONFIDENCE = 3, 1.3, 1e3
"""Rounds in which errors that are smaller than expected get a larger weight against the priors of physics, the least
factor of that, and the largest in all.
"""

APART = 2.0
"""Standard errors from a solution at which searches begin again, on both sides."""

RIVAL, ALIKE = 1.1, 0.01
"""Cost of an end, over the best one's, up to which a search goes on from it, too; and the difference of parameters, in
their scales, up to which two ends are the same.
"""
MANY = 100
"""Number of weights, which all have priors, above which the optimiser gets a condensed problem."""


def fit(
    system: System,
    experiments: Sequence[PreparedRecord],
    *,
    stages: Sequence[int | None] = STAGES,
    anchor: Fit | None = None,
    ridge: float = 1.0,
    hold: Sequence[str] = (),
    starts: int = 1,
    seed: int = 0,
    tolerance: float | None = None,
    iterations: int = ITERATIONS,
    unstable: UnstableFitSettings | None = None,
    again: bool = False,
    progress: FitProgress | None = None,
) -> Fit:
    """Fit the free parameters and weights of a system to several experiments at once.

    anchor: an earlier fit of the same physics, near which its parameters stay (within a few deviations), so that a
    network learns only the part that the physics can't explain. ridge, hold: see
    :class:`~hybrid_sysid_ros.identification.problem.FitProblem`. starts: number of initial points of the first stage,
    all but the first random by ``seed``; the best end continues, and of physics those that are hardly worse.
    tolerance, iterations: limits of each stage, by default FINE in the last one of a physical structure, COARSE
    elsewhere, and ITERATIONS. unstable: settings of an unstable rig, which replace the stages, see
    :class:`~.shooting.MultipleShootingProblem`. again: search again from both sides of the solution of a system that
    sticks, see :func:`_searched_again`. The method is trust-region least squares with bounds; the Jacobian is exact
    and simulated in parallel threads.

    Raises UserError for records without excitation or beyond the system's range, and where every simulation
    diverges.
    """
    system = _ranged(system, experiments)
    centres, spreads = (None, None) if anchor is None else _anchors(system, anchor)
    options: dict[str, Any] = {"centres": centres, "spreads": spreads, "ridge": ridge, "hold": hold}
    problem = FitProblem(system, experiments, **options)
    if unstable is not None:
        problem = MultipleShootingProblem(system, experiments, unstable, **options)
        stages = problem.stages
    problem.residuals(stages[0])(problem.start)  # compile outside the measured time
    problem.jacobian(stages[0], map)(problem.start)
    problem.evaluations = 0
    began = time.perf_counter()
    points = problem.starts(starts, seed)
    # The simulations run in parallel: threads of linear algebra would only compete with them.
    with ThreadPoolExecutor(max_workers=threads.available()) as pool, threadpool_limits(1):
        for horizon in stages:
            problem.carry(points[0], horizon)
            points = [problem.with_hidden_starts(point, horizon) for point in _kept(problem, points, horizon)]
            physical = horizon == stages[-1] and not len(system.weights)
            limits = tolerance or (FINE if physical else COARSE), iterations
            solutions = [_solve(problem, horizon, point, limits, pool.map) for point in points]
            solution = min(solutions, key=lambda item: float(item.cost))
            points = [solution.x] if len(system.weights) else _rivals(solutions, problem.shared)
            if progress is not None:
                stage = "whole records" if horizon is None else f"{horizon}-sample rollouts"
                progress(stage, problem.evaluations, problem.relative_error(solution.fun))
        if not len(system.weights) and unstable is None and np.isfinite(problem.spreads).any():
            solution = _reweighted(problem, stages[-1], solution, (tolerance or FINE, iterations), pool.map)
        spread = np.zeros((len(solution.x), len(solution.x)))
        if again and system.contacts and unstable is None:
            limits = tolerance or FINE, iterations
            solution, spread = _searched_again(problem, stages[-1], solution, limits, pool.map)
    found = problem.with_point(solution.x)
    if unstable is None and problem.lead_of(found) > problem.lead:  # what acted before the records bent this fit
        options = {"anchor": anchor, "ridge": ridge, "hold": hold, "tolerance": tolerance, "iterations": iterations}
        return fit(found, experiments, stages=stages[-1:], again=again, progress=progress, **options)
    relative = problem.relative_error(solution.fun)
    if not np.isfinite(relative) or relative > 1e3:
        raise UserError("identification: every simulation diverges; start from a simpler structure or a smaller step")
    seconds, evaluations = time.perf_counter() - began, problem.evaluations
    return _with_errors(problem, stages[-1], solution, spread, anchor, seconds=seconds, evaluations=evaluations)


def _kept(problem: FitProblem, points: list[Array], horizon: int | None) -> list[Array]:
    """Points to go on from, and the start where what shorter rollouts taught makes longer ones worse: small errors of
    rates that no rollout integrates for long may move a slow state anywhere.
    """
    residuals = problem.residuals(horizon)
    worse = np.linalg.norm(residuals(problem.start)) < min(float(np.linalg.norm(residuals(point))) for point in points)
    return [*points, problem.start] if worse else points


def _rivals(solutions: Sequence[Any], shared: int) -> list[Array]:
    """The best of some ends first, and others elsewhere in the shared part that are hardly worse: short rollouts don't
    tell ends apart of which longer ones reject all but one.
    """
    first, *others = sorted(solutions, key=lambda item: float(item.cost))
    found: list[Array] = [first.x]
    for item in others:
        elsewhere = all(np.max(np.abs(item.x - x)[:shared]) > ALIKE for x in found)
        if item.cost < RIVAL * first.cost and elsewhere:
            found.append(item.x)
    return found


def _reweighted(problem: FitProblem, horizon: int | None, solution: Any, limits: tuple[float, int], run: Map) -> Any:
    """A solution with larger weights of errors that are smaller than expected, see REWEIGHTED."""
    for _ in range(REWEIGHTED):
        more = confidence(solution.jac, solution.fun, problem.edges(horizon))
        if more < WORTHWHILE:
            break
        problem.confidence *= min(more, MOST_CONFIDENCE / problem.confidence)
        solution = _solve(problem, horizon, solution.x, limits, run)
    return solution


def _searched_again(
    problem: FitProblem, horizon: int | None, solution: Any, limits: tuple[float, int], run: Map
) -> tuple[Any, Array]:
    """The best of a solution and of searches from both its sides, and the mean square of where the others end (n, n).

    Where a system sticks the cost has corners, in which a search ends early: no curvature there says how far other ends
    are. Ends count whose cost is higher by less than errors of the estimate make it on average, tr(H C) / 2.
    """
    edges = problem.edges(horizon)
    _, robust = covariances(solution.jac, solution.fun, edges)
    values, vectors = np.linalg.eigh(robust)
    draw = vectors @ (np.sqrt(np.maximum(values, 0.0)) * np.random.default_rng(0).choice([-1.0, 1.0], len(values)))
    draw *= APART / np.sqrt(len(values))
    ends = [solution, *(_solve(problem, horizon, solution.x + side * draw, limits, run) for side in (-1.0, 1.0))]
    best = min(ends, key=lambda item: float(item.cost))
    alike = 0.5 * float(np.sum((best.jac.T @ best.jac) * robust))
    moves = np.array([item.x - best.x for item in ends if item is not best and item.cost - best.cost < alike])
    return best, moves.T @ moves / max(len(moves), 1) if len(moves) else np.zeros_like(robust)


def _with_errors(
    problem: FitProblem,
    horizon: int | None,
    solution: Any,
    spread: Array,
    anchor: Fit | None,
    *,
    seconds: float,
    evaluations: int,
) -> Fit:
    """The fit of a solution, with its standard errors; spread: covariance of the ends of other searches."""
    free_runs = not isinstance(problem, MultipleShootingProblem)
    units, edges = np.outer(problem.scales, problem.scales), problem.edges(horizon)
    jacobian = solution.jac
    if problem.system.contacts and free_runs:
        jacobian = secant_jacobian(problem.residuals(horizon), solution.x, jacobian, edges)
    priors = problem.prior_covariance(None if anchor is None else anchor.covariance)
    shifts = known_errors(problem, solution.x, horizon) if problem.is_open(horizon) else None
    inverse, robust = covariances(jacobian, solution.fun, edges, priors=priors, shifts=shifts)
    known = np.diag(inverse) > 0.0
    robust += spread * np.outer(known, known)  # searches that leave a number where it is say nothing of it
    shared, lag = slice(problem.shared), lag_of_sensors(problem)
    robust[shared, shared] += np.outer(lag, lag)
    data = jacobian[: edges[-1]]
    return Fit(
        system=problem.with_point(solution.x),
        names=problem.names,
        covariance=robust[shared, shared] * units,
        by_cost=inverse[shared, shared] * units,
        step_error=np.zeros(0) if shifts is None else (inverse @ (jacobian.T @ shifts[0]))[shared] * problem.scales,
        effective=float(np.trace(inverse @ (data.T @ data))),
        block_spread=block_spread(jacobian, solution.fun, edges)[shared] * problem.scales,
        nuisances=problem.named_nuisances(solution.x),
        relative_error=problem.relative_error(solution.fun),
        seconds=seconds,
        evaluations=evaluations,
        chi_squared=problem.chi_squared(solution.fun),
    )


def _ranged(system: System, experiments: Sequence[PreparedRecord]) -> System:
    """The system, given the range of its training data."""
    for experiment in experiments:
        check_range(experiment, system)
    states = np.concatenate([experiment.states for experiment in experiments])
    system = system.trained_on(states.min(axis=0), states.max(axis=0))
    system.check()
    return system


def _anchors(system: System, fitted: Fit) -> tuple[Array, Array]:
    """Prior centres and deviations (free,) of parameters from an earlier fit."""
    free = [i for i, item in enumerate(system.parameters) if item.name in fitted.names]
    spreads, scales = fitted.spreads[: len(free)], np.array([system.parameters[i].scale for i in free])
    return fitted.system.values[free], ANCHOR * np.where(spreads > 0.0, spreads, scales)  # 0: nothing determined it


def _solve(problem: FitProblem, horizon: int | None, point: Array, limits: tuple[float, int], run: Map) -> Any:
    """Solve one stage from a point. limits: tolerance and iterations."""
    tolerance, iterations = limits
    lower, upper = problem.bounds
    residuals, jacobian = problem.residuals(horizon), problem.jacobian(horizon, run)
    many = len(problem.system.weights) >= MANY
    asked = CondensedResiduals(residuals, jacobian) if many else None
    found = scipy.optimize.least_squares(
        asked.residuals if asked else residuals,
        np.clip(point, lower, upper),
        asked.jacobian if asked else jacobian,
        bounds=(lower, upper),
        method="trf",
        ftol=tolerance,
        xtol=tolerance,
        max_nfev=iterations,
    )
    if many:
        found.fun, found.jac = residuals(found.x), jacobian(found.x)
    return found
