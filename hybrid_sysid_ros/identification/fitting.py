"""Least squares on compiled rollouts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from hybrid_sysid_ros.equations import Equation, kernels
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.identification.experiment import Experiment

Array = NDArray[np.float64]
Progress = Callable[[str, int, float], None]
"""progress(stage, evaluations, root mean square error relative to the output's deviation)"""

STAGES: tuple[int | None, ...] = (20, 60, 200, None)
"""Samples of the rollouts in each stage; None is the whole record. Short ones first keep the cost near convex."""

RELATIVE_ERROR = 0.05
"""Expected free-run error, as part of the output's deviation: it weighs the data against the priors."""

CORRELATION_SECONDS = 1.0
"""Free-run errors are slow: this many seconds of them count as one observation against the priors."""

ANCHOR = 3.0
"""Spread of an anchored parameter, in standard errors of the fit it is anchored to."""

ITERATIONS, COARSE, FINE = 40, 1e-3, 1e-6
"""Limits of each stage. The last one of a physical structure is fine, for its parameters' sake; a network that is
stopped early simulates unseen records as well, in half the time."""

DIFFERENCE = 1e-5
"""Step of the forward differences, in units of a parameter's scale."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted equation with the covariance (free, free) of its free parameters, in their units.

    names: the free parameters, physical ones first, then weights. seconds: time of the optimisation, without
    compilation. evaluations: calls of the residuals, those of finite differences included.
    """

    equation: Equation
    names: tuple[str, ...]
    covariance: Array
    relative_error: float
    seconds: float
    evaluations: int


class Problem:
    """The residuals of one equation on several experiments, as a function of its free parameters (scaled)."""

    def __init__(self, equation: Equation, experiments: Sequence[Experiment], anchor: Fit | None) -> None:
        if len({experiment.sampling for experiment in experiments}) > 1:
            raise UserError("identification: the records are sampled differently")
        self.equation = equation
        self.experiments = experiments
        self.sampling = experiments[0].sampling
        self.inputs = np.concatenate([experiment.inputs for experiment in experiments])
        self.first_steps = np.cumsum([0, *(len(experiment.inputs) for experiment in experiments)])[:-1]
        self.deviation = np.std(np.concatenate([item.outputs - item.outputs.mean(0) for item in experiments]), axis=0)
        for output, deviation in enumerate(self.deviation):
            if deviation < 1e-9:
                name = equation.states[equation.outputs[output]].name
                raise UserError(f"identification: output {name} is constant in every record; nothing to identify")
        for column in range(self.inputs.shape[1]):
            if np.ptp(self.inputs[:, column]) < 1e-9:
                name = equation.inputs[column].name
                raise UserError(f"identification: input {name} is constant in every record; excite the rig")
        self.kernels = kernels(equation)
        self.all = equation.parameters
        self.free = [index for index, item in enumerate(self.all) if not item.fixed]
        self.scales = np.concatenate([[self.all[i].scale for i in self.free], np.ones(len(equation.weights))])
        self.fixed_values = equation.values
        self.centres = np.array([self.all[i].start for i in self.free])
        self.spreads = np.array([self.all[i].spread or np.inf for i in self.free])
        if anchor is not None:
            physical = len(self.free)
            self.centres = anchor.equation.values[self.free]
            self.spreads = ANCHOR * np.sqrt(np.diag(anchor.covariance))[:physical]
        self.evaluations = 0

    @property
    def start(self) -> Array:
        return np.concatenate([self.equation.values[self.free], self.equation.weights]) / self.scales

    @property
    def bounds(self) -> tuple[Array, Array]:
        weights = np.full(len(self.equation.weights), np.inf)
        low = np.concatenate([[self.all[i].low for i in self.free], -weights]) / self.scales
        return low, np.concatenate([[self.all[i].high for i in self.free], weights]) / self.scales

    @property
    def names(self) -> tuple[str, ...]:
        weights = tuple(f"weight_{index}" for index in range(len(self.equation.weights)))
        return tuple(self.all[i].name for i in self.free) + weights

    def with_point(self, point: Array) -> Equation:
        """The equation at a point (free,) of the scaled parameters."""
        values = self.fixed_values.copy()
        free = point * self.scales
        values[self.free] = free[: len(self.free)]
        equation = self.equation.with_values(values)
        return equation.with_weights(free[len(self.free) :]) if len(self.equation.weights) else equation

    def priors(self, point: Array) -> Array:
        """Prior rows, each in its own deviation: parameters about their centres, weights about zero."""
        physical = len(self.free)
        values = point[:physical] * self.scales[:physical]
        return np.concatenate([(values - self.centres) / self.spreads, point[physical:]])

    def windows(self, horizon: int | None) -> tuple[NDArray[np.int64], Array, Array]:
        """Rollouts of ``horizon`` samples: starts (windows, 4), initial states (windows, states), outputs."""
        starts, states, outputs, offset = [], [], [], 0
        for first, experiment in zip(self.first_steps, self.experiments, strict=True):
            length = experiment.samples - 1 if horizon is None else min(horizon, experiment.samples - 1)
            for begin in range(0, experiment.samples - length, length):
                starts.append((first, first + begin * self.sampling.every, length + 1, offset))
                states.append(experiment.states[begin])
                outputs.append(experiment.outputs[begin : begin + length + 1])
                offset += length + 1
        return np.array(starts, dtype=np.int64), np.array(states), np.concatenate(outputs)

    def residuals(self, horizon: int | None) -> Callable[[Array], Array]:
        """Weighted output errors of all rollouts, followed by the priors."""
        starts, states, outputs = self.windows(horizon)
        measured = list(self.equation.outputs)
        seconds = len(outputs) * self.sampling.period
        weight = np.sqrt(max(seconds / CORRELATION_SECONDS, 1.0) / outputs.size) / (RELATIVE_ERROR * self.deviation)
        steps = self.sampling.step

        def evaluate(point: Array) -> Array:
            equation = self.with_point(point)
            out = np.empty((len(outputs), len(equation.states)))
            self.kernels.windows(
                starts,
                states,
                self.inputs,
                equation.delay / steps,
                self.sampling.every,
                equation.named,
                equation.weights,
                steps,
                out,
            )
            self.evaluations += 1
            errors = ((out[:, measured] - outputs) * weight).ravel()
            # A diverging simulation must repel the search, not stop it.
            errors = np.nan_to_num(np.clip(errors, -1e6, 1e6), nan=1e6)
            return np.concatenate([errors, self.priors(point)])

        return evaluate


def fit(
    equation: Equation,
    experiments: Sequence[Experiment],
    *,
    stages: Sequence[int | None] = STAGES,
    anchor: Fit | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit the free parameters and weights of an equation to several experiments at once.

    anchor: an earlier fit of the same physics, about which its parameters then stay (within a few standard errors):
    what the physics can't explain is left to a network. Trust-region least squares with bounds; forward-difference
    Jacobian, its columns simulated in parallel threads.
    Raises UserError for records without excitation or of values that the equation forbids, and where every simulation
    diverges.
    """
    low = np.min([experiment.states.min(axis=0) for experiment in experiments], axis=0)
    high = np.max([experiment.states.max(axis=0) for experiment in experiments], axis=0)
    equation = equation.trained_on(low, high)
    try:
        equation.check()
    except UserError as error:
        raise UserError(f"identification: {error}; it comes from the records, which must be in SI units") from None
    problem = Problem(equation, experiments, anchor)
    problem.residuals(STAGES[0])(problem.start)  # compile outside the measured time
    problem.evaluations = 0
    began = time.perf_counter()
    point = problem.start
    lower, upper = problem.bounds
    # The simulations are the parallel part: threads of linear algebra would only spin beside them.
    with ThreadPoolExecutor(max_workers=2) as threads, threadpool_limits(1):
        for horizon in stages:
            residuals = problem.residuals(horizon)

            def jacobian(at: Array, residuals: Callable[[Array], Array] = residuals) -> Array:
                base = residuals(at)
                steps = np.where(at + DIFFERENCE > upper, -DIFFERENCE, DIFFERENCE)
                moved = [at + step * unit for step, unit in zip(steps, np.eye(len(at)), strict=True)]
                columns = threads.map(residuals, moved)
                return np.stack([(col - base) / step for col, step in zip(columns, steps, strict=True)], axis=1)

            physical = horizon == stages[-1] and not len(equation.weights)
            tolerance = FINE if physical else COARSE
            solution = least_squares(
                residuals,
                np.clip(point, lower, upper),
                jacobian,
                bounds=(lower, upper),
                method="trf",
                ftol=tolerance,
                xtol=tolerance,
                max_nfev=ITERATIONS,
            )
            point = solution.x
            rows = len(solution.fun) - len(problem.priors(point))
            relative = float(np.sqrt(np.mean(solution.fun[:rows] ** 2) * rows)) * RELATIVE_ERROR
            seconds = sum(item.samples for item in experiments) * problem.sampling.period
            relative /= np.sqrt(max(seconds / CORRELATION_SECONDS, 1.0))
            if progress is not None:
                progress(
                    "whole records" if horizon is None else f"{horizon}-sample rollouts", problem.evaluations, relative
                )
    if not np.isfinite(relative) or relative > 1e3:
        raise UserError("identification: every simulation diverges; start from a simpler structure or a smaller step")
    information = solution.jac.T @ solution.jac
    covariance = np.linalg.pinv(information, hermitian=True) * np.outer(problem.scales, problem.scales)
    return Fit(
        equation=problem.with_point(point),
        names=problem.names,
        covariance=covariance,
        relative_error=relative,
        seconds=time.perf_counter() - began,
        evaluations=problem.evaluations,
    )
