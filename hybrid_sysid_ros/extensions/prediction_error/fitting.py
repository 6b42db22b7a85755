"""The prediction-error criterion, and a fit by it.

    V(theta, q, r) = 1/2 sum_k [ e_k^2 / v_k + log v_k ] + 1/2 |(theta - centre) / spread|^2

e_k and v_k are the innovations of a filter (:mod:`.innovations`) and their variances: the likelihood of the record, and
the only criterion in this module: L. Ljung (1999), System Identification, 2nd ed., sections 7.2 and 7.4. Its minimum is
searched by damped scoring, with Fisher's information for the curvature (section 10.2).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.prediction_error.innovations import innovations
from hybrid_sysid_ros.identification.problem import FitProblem
from hybrid_sysid_ros.identification.standard_errors import block_spread, covariances
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.support import threads
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LEAST_WALK, FIRST_WALK, MOST_WALK = 1e-6, 1e-3, 10.0
"""Walks of an input's offset after a second, in its deviation: bounds, and where a fit begins."""
LEAST_NOISE, FIRST_NOISE, MOST_NOISE = 0.03, 3.0, 1e4
"""Noise of a sensor in that of the record about a smooth curve: bounds, and where a fit begins."""
DIFFERENCE = 1e-4
"""Differences for derivatives, in the parameters' scales."""
ITERATIONS, TOLERANCE = 40, 1e-7


def fitted(system: System, records: Sequence[PreparedRecord], before: Fit, hold: Sequence[str]) -> Fit:
    """The fit of a system by prediction error, from an earlier fit of the same parameters.

    Raises UserError where the filter can't be run or the criterion is not finite at its beginning.
    """
    if not before.names:
        raise UserError("criterion prediction: no parameter is free")
    if system.sensing is not None and system.sensing.late:
        raise UserError("criterion prediction: the filter takes readings as they come: leave delay and window out")
    began = time.perf_counter()
    criterion = PredictionError(system, records, hold)
    start = criterion.point(system)
    if not np.isfinite(criterion.value(start)):
        raise UserError("criterion prediction: the filter diverges over the records; take the criterion simulation")
    with ThreadPoolExecutor(max_workers=threads.available()) as pool:
        point, scores, errors, edges = criterion.least(start, pool)
    inverse, robust = covariances(scores, errors, edges)
    count, scales = len(criterion.problem.free), criterion.scales
    physical, units = slice(count), np.outer(scales, scales)[:count, :count]
    by_blocks = block_spread(scores, errors, edges)[physical] * scales[physical]
    shift = before.step_error if len(before.step_error) == count else np.zeros(count)
    values, deviations = point[count:], np.sqrt(np.diag(robust))[count:]
    numbers = {
        name: {"value": float(np.exp(value)), "standard_error": float(np.exp(value) * deviation)}
        for name, value, deviation in zip(criterion.noise_names, values, deviations, strict=True)
    }
    return replace(
        before,
        system=criterion.system(point),
        covariance=robust[physical, physical] * units + np.outer(shift, shift),
        by_cost=inverse[physical, physical] * units,
        effective=float(count),
        block_spread=by_blocks,
        seconds=before.seconds + time.perf_counter() - began,
        evaluations=before.evaluations + criterion.evaluations,
        notes={**before.notes, "prediction": numbers},
    )


@dataclass(eq=False)
class PredictionError:
    """The criterion as a function of a point: free parameters in their scales, logarithms of walks and of noise."""

    physics: System
    records: Sequence[PreparedRecord]
    hold: Sequence[str]

    def __post_init__(self) -> None:
        self.problem = FitProblem(self.physics, self.records, hold=self.hold)
        self.evaluations = 0
        inputs, outputs = self.problem.inputs, np.concatenate([item.followed for item in self.records])
        sizes = np.maximum(np.std(inputs, axis=0), 1e-12)
        smooth = [np.full(outputs.shape[1], 1e-3) if item.noise is None else item.noise for item in self.records]
        noise = np.maximum(np.sqrt(np.mean(np.square(smooth), axis=0)), 1e-6 * np.std(outputs, axis=0))
        self._low = np.log(np.concatenate([LEAST_WALK * sizes, LEAST_NOISE * noise]))
        self._first = np.log(np.concatenate([FIRST_WALK * sizes, FIRST_NOISE * noise]))
        self._high = np.log(np.concatenate([MOST_WALK * sizes, MOST_NOISE * noise]))
        self.scales = np.concatenate([self.problem.scales, np.ones(len(self._low))])
        states = np.concatenate([item.states for item in self.records])
        hidden = self.problem.hidden
        self._spreads = np.maximum(np.std(states, axis=0), 1e-9)
        self._spreads[hidden] = np.maximum(self._spreads[hidden], [self.problem._sizes[i] for i in hidden])

    @property
    def noise_names(self) -> list[str]:
        """What the logarithms behind the parameters are of."""
        walks = [f"walk of {item.name} [{item.unit}/sqrt(s)]" for item in self.physics.inputs]
        return walks + [f"noise of {item.name} [{item.unit}]" for item in self.physics.outputs]

    @property
    def bounds(self) -> tuple[Array, Array]:
        low, high = (values[: len(self.problem.free)] for values in self.problem.bounds)
        return np.concatenate([low, self._low]), np.concatenate([high, self._high])

    def point(self, system: System) -> Array:
        """The point at which a fit begins."""
        low, high = self.bounds
        own = system.values[self.problem.free] / self.problem.scales
        return np.clip(np.concatenate([own, self._first]), low, high)

    def system(self, point: Array) -> System:
        """The system at a point."""
        values = self.physics.values
        count = len(self.problem.free)
        values[self.problem.free] = point[:count] * self.problem.scales
        return self.physics.with_values(values)

    def _innovations(self, point: Array) -> list[tuple[Array, Array]]:
        """Of each record, innovations and variances of what was measured, (samples, outputs)."""
        m, count = len(self.physics.inputs), len(self.problem.free)
        walks, noise = np.exp(point[count : count + m]), np.exp(point[count + m :])
        self.evaluations += 1
        system = self.system(point)
        given: dict[str, Any] = {"walks": walks, "noise": noise, "spreads": self._spreads}
        found = []
        for record in self.records:
            used = slice(None) if record.measured is None else record.measured[1:]
            errors, variances = innovations(system, record, **given)
            found.append((errors[used], variances[used]))
        return found

    def _priors(self, point: Array) -> Array:
        count = len(self.problem.free)
        return np.asarray((point[:count] * self.problem.scales - self.problem.centres) / self.problem.spreads)

    def value(self, point: Array) -> float:
        """The criterion; infinite where the filter diverges."""
        found = 0.5 * float(np.sum(self._priors(point) ** 2))
        for errors, variances in self._innovations(point):
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                found += 0.5 * float(np.sum(errors**2 / variances + np.log(variances)))
        return found if np.isfinite(found) else np.inf

    def least(self, point: Array, pool: ThreadPoolExecutor) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """The point of the least criterion near another one, and the :meth:`scores` there."""
        low, high = self.bounds
        value, damping = self.value(point), 1e-3
        scores, errors, edges = self.scores(point, pool)
        for _ in range(ITERATIONS):
            slope, information = scores.T @ errors, scores.T @ scores
            free = ~(((point <= low) & (slope > 0.0)) | ((point >= high) & (slope < 0.0)))
            before, moved = value, False
            while damping < 1e6 and not moved:
                damped = information + damping * np.diag(np.maximum(np.diag(information), 1e-12))
                step = np.zeros_like(point)
                step[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
                trial = np.clip(point + step, low, high)
                tried = self.value(trial)
                moved = tried < value
                damping = max(damping / 10.0, 1e-9) if moved else 10.0 * damping
                if moved:
                    point, value = trial, tried
            if not moved:
                break
            scores, errors, edges = self.scores(point, pool)
            if before - value < TOLERANCE * max(1.0, abs(value)):
                break
        return point, scores, errors, edges

    def scores(self, point: Array, pool: ThreadPoolExecutor) -> tuple[Array, Array, NDArray[np.int64]]:
        """Rows J and e with J' J Fisher's information of e_k and v_k and J' e the criterion's slope, so that each row's
        mean is zero; and the first row of each record. Rows after the last edge are priors.
        """

        def flat(at: Array) -> Array:
            return np.concatenate([np.stack(pair, axis=-1).ravel() for pair in self._innovations(at)])

        values = flat(point).reshape(-1, 2)
        slopes = _differences(flat, point, np.full(len(point), DIFFERENCE), self.bounds, pool)
        by_error, by_variance = slopes[0::2], slopes[1::2]
        errors, variances = values[:, 0, None], values[:, 1, None]
        jacobian, rest = np.empty_like(slopes), np.empty(len(slopes))
        jacobian[0::2], rest[0::2] = by_error / np.sqrt(variances), (errors / np.sqrt(variances))[:, 0]
        jacobian[1::2] = by_variance / (np.sqrt(2.0) * variances)
        rest[1::2] = ((1.0 - errors**2 / variances) / np.sqrt(2.0))[:, 0]
        count = len(self.problem.free)
        priors = np.zeros((count, len(point)))
        priors[:, :count] = np.diag(self.problem.scales / self.problem.spreads)
        edges = 2 * np.cumsum([0, *(errors.size for errors, _ in self._innovations(point))])
        return np.concatenate([jacobian, priors]), np.concatenate([rest, self._priors(point)]), edges


def _differences(function: Any, point: Array, steps: Array, bounds: tuple[Array, Array], pool: Any) -> Array:
    """Central differences of a function, one-sided at a bound, (rows, n)."""

    def column(k: int) -> Array:
        ends = []
        for side in (-1.0, 1.0):
            moved = point.copy()
            moved[k] = np.clip(moved[k] + side * steps[k], bounds[0][k], bounds[1][k])
            ends.append((moved[k], function(moved)))
        (a, below), (b, above) = ends
        return np.asarray((above - below) / (b - a))

    return np.stack(list(pool.map(column, range(len(point)))), axis=1)
