"""Fits of unstable rigs over windows with free initial states, first in open loop, then closed by a stabiliser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Sensitivities, System, rollouts
from hybrid_sysid_ros.core.rollout import Starts
from hybrid_sysid_ros.core.symbolic import linearised
from hybrid_sysid_ros.core.wrappers import feedback_of
from hybrid_sysid_ros.identification.problem import FitProblem, Map, Residuals
from hybrid_sysid_ros.identification.starts import root_mean_squares, start_of
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

GROWTHS = (1.4, 3.6)
"""Lengths of the open windows, in times in which an error grows by e: it grows by factors of 4 and 36."""
GAUSS_NEWTON, STILL = 8, 1e-6
"""Most Gauss-Newton steps of the initial states, and the relative change of the residual that ends them."""
MOST_GROWTH = 1e6
"""Growth of an error of the initial state over a free run above which the run is meaningless."""
LOOKED = 200
"""States of a record, about, at which modes are looked at."""
FAR, EVEN = 0.1, 0.5
"""Distance of runs in the output's deviation, from which they part, and the even part of what they answer to moves of
the start, in the odd part, from which they go either way.
"""
SLOWEST = 0.05
"""Growth rate [1/s] below which a rig counts as stable, since windows would be as long as records."""


@dataclass(frozen=True, kw_only=True, eq=False)
class UnstableFitSettings:
    """Settings for identification and validation of an unstable rig."""

    noise: Array
    """Noise of each output's sensor, rms in SI, (outputs,)."""
    stabiliser: Array | None = None
    """K (inputs, outputs) of u = v - K y, which stabilises the rig, in SI; None: nobody knows it, so that all windows
    are open.
    """
    growth: float = 0.0
    """Rate [1/s] by which an error grows, which the open windows are as long as; 0: that of the fastest mode at rest.
    """
    closed: float = 0.0
    """Length [s] of the last windows, in which the stabiliser closes the loop; 0: none."""


def unstable_settings(rig: Rig) -> UnstableFitSettings | None:
    """Settings of a rig that declares a stabiliser (experiments.stabiliser); None for other rigs."""
    if rig.experiments.stabiliser is None:
        return None
    return replace(open_windows(rig), stabiliser=rig.experiments.stabiliser, closed=rig.experiments.closed_windows)


def open_windows(rig: Rig, growth: float = 0.0) -> UnstableFitSettings:
    """Settings of an unstable rig that declares no stabiliser, or of one whose runs part. growth: see
    :class:`UnstableFitSettings`.
    """
    noise = np.array([sensor.noise * abs(sensor.scale) for sensor in rig.sensors])
    return UnstableFitSettings(noise=noise, growth=growth)


def runs_away(system: System, experiment: PreparedRecord) -> bool:
    """Whether an error of the initial state grows more than MOST_GROWTH times over a record, by the fastest mode."""
    seconds = experiment.sampling.period * (experiment.samples - 1)
    return bool(fastest_growth(system) * seconds > np.log(MOST_GROWTH))


def fastest_growth(system: System) -> float:
    """Growth rate of the fastest mode where states and inputs are zero [1/s]; 0 where none grows."""
    if system.sampling_time:
        return 0.0
    return _growth(system, np.zeros(len(system.states)), np.zeros(len(system.inputs)))


def growth_along(system: System, experiment: PreparedRecord) -> float:
    """Growth rate of the fastest mode at the states of a record [1/s]; 0 where none grows anywhere."""
    if system.sampling_time:
        return 0.0
    states, every = np.zeros(len(system.states)), max(experiment.samples // LOOKED, 1)
    shown, found = experiment.states.shape[1], [0.0]
    for k in range(0, experiment.samples - 1, every):
        states[:shown] = experiment.states[k]
        found.append(_growth(system, states, experiment.inputs[k * experiment.sampling.every]))
    return max(found)


def _growth(system: System, x: Array, u: Array) -> float:
    """Largest real part of the modes at x (states,) and u (inputs,) [1/s], at least 0."""
    transition, _ = linearised(system, x, u)
    return float(max(np.max(np.linalg.eigvals(transition).real, initial=0.0), 0.0))


def parts_from(system: System, experiment: PreparedRecord) -> float | None:
    """Time [s] from which runs over a record part, so that none is predictable; None where they don't.

    Runs r from what is not known of the start, x0 + s and x0 - s for each of its principal deviations s, part where

        |r(+s) + r(-s) - 2 r(0)| > EVEN |r(+s) - r(-s)|   and   > FAR sigma(y):

    past an unstable point, as a pendulum's top, they go either way, whereas errors that only grow answer oddly.
    """
    start, sampling, count = start_of(system, experiment), experiment.sampling, experiment.samples
    values, vectors = np.linalg.eigh(start.covariance)
    moves = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    first = np.repeat(start.state[None], 1 + 2 * len(moves), axis=0)
    first[1:, list(start.estimated)] += np.concatenate([moves, -moves])
    starts = np.array([[0, 0, count, k * count] for k in range(len(first))])
    _, runs = rollouts(system, starts, first, experiment.inputs, step=sampling.step, every=sampling.every)
    middle, (up, down) = runs[:count], runs[count:].reshape(2, len(moves), *runs[:count].shape)
    with np.errstate(over="ignore", invalid="ignore"):
        even, odd = np.abs(up + down - 2.0 * middle), np.abs(up - down)
    parted = (even > EVEN * odd) & (even > FAR * np.std(experiment.outputs, axis=0))
    where = np.flatnonzero(parted.any(axis=(0, 2)))
    return float(where[0] * sampling.period) if len(where) else None


def check_sampling(sampling: Sampling, name: str) -> None:
    """Raise UserError where there are not outputs at each step, at which a stabiliser acts."""
    if sampling.every != 1:
        raise UserError(
            f"{name}: a stabiliser acts at each step of {sampling.step:g} s, but the outputs are scored every "
            f"{sampling.period:g} s: give a period as long as the step, that of the record's samples"
        )


def held_inputs(system: System, experiment: PreparedRecord, stabiliser: Array) -> Array:
    """The inputs v = u + K y of a record, (steps, inputs), for a simulation with the stabiliser u = v - K y, whose
    states act at once: y is taken a delay later, when u acts.

    Raises UserError where there are not outputs at each step.
    """
    check_sampling(experiment.sampling, experiment.name)
    fed, steps = experiment.outputs @ stabiliser.T, np.arange(experiment.samples)
    delays = system.input_delays / experiment.sampling.step
    late = [np.interp(steps[:-1] + delay, steps, part) for delay, part in zip(delays, fed.T, strict=True)]
    return experiment.inputs + np.column_stack(late)


def settled(
    system: System,
    starts: Starts,
    states: Array,
    inputs: Array,
    outputs: Array,
    *,
    free: Sequence[int],
    noise: Array,
    step: float,
    every: int,
    feedback: Array | None = None,
) -> Array:
    """Initial states (windows, states) that fit the outputs (rows, outputs) of each window best in least squares, by
    Gauss-Newton from given ones; only ``free`` states change, in all windows at once.
    """
    sensitivities = Sensitivities(system, parameters=(), states=list(free))
    given: dict[str, Any] = {"step": step, "every": every, "feedback": feedback}
    jacobian = np.empty((len(outputs), outputs.shape[1], sensitivities.count))
    first = sensitivities.count - len(free)
    best, costs = states.copy(), np.full(len(starts), np.inf)
    trial = states.copy()
    for _ in range(GAUSS_NEWTON):
        _, found = rollouts(system, starts, trial, inputs, **given)
        errors = np.nan_to_num(np.clip((outputs - found) / noise, -1e6, 1e6), nan=1e6)
        sums = np.add.reduceat(np.sum(errors**2, axis=1), starts[:, 3])
        better = sums < costs
        gained = np.where(better, np.minimum(costs, 1e300) - sums, 0.0)
        best[better] = trial[better]
        moved = better & (gained > STILL * sums)
        costs = np.minimum(costs, sums)
        if not moved.any():
            break
        sensitivities.rollouts(system, starts, best, inputs, **given, out=jacobian)
        trial = best.copy()
        for window in np.flatnonzero(moved):
            rows = slice(starts[window, 3], starts[window, 3] + starts[window, 2])
            matrix = (jacobian[rows, :, first:] / noise[:, None]).reshape(-1, len(free))
            if np.isfinite(matrix).all():
                trial[window, free] += np.linalg.lstsq(matrix, errors[rows].ravel(), rcond=1e-10)[0]
    return best


class MultipleShootingProblem(FitProblem):
    """The residuals of one system on several experiments, over windows whose initial states are free.

        free parameters, weights

    The initial states of each window are not part of the point: at every point they are those that fit the window best,
    and the derivatives account for that (variable projection, Golub & Pereyra 1973, SIAM J. Numer. Anal. 10(2), as
    Kaufman 1975 simplified it; multiple shooting, Bock 1983, eliminates the same by a Schur complement). Errors are in
    units of their sensors' noise. In windows longer than the open ones the stabiliser closes the loop; without one all
    are open, and each state needs a record that shows it.
    """

    def __init__(
        self, system: System, experiments: Sequence[PreparedRecord], settings: UnstableFitSettings, **options: Any
    ) -> None:
        """options: those of :class:`~.problem.FitProblem`."""
        self._stabiliser = settings.stabiliser
        super().__init__(system, experiments, **options)
        self.moved_states, self.nuisance_units = [], np.zeros(0)
        self._shown = sorted(set(range(len(system.declared_states))) - set(self.hidden))
        self._noise = np.where(settings.noise > 0.0, settings.noise, 1e-3 * self.deviation)
        growth = max(settings.growth or fastest_growth(system), SLOWEST)
        period = self.sampling.period
        lengths = [max(round(rate / growth / period), 2) for rate in GROWTHS]
        self._open = lengths[-1]
        last = [round(settings.closed / period)] if settings.closed and settings.stabiliser is not None else []
        self.stages: tuple[int | None, ...] = (*lengths, *last)
        """Samples of the windows of each stage."""
        self._initial: dict[int | None, Array] = {}

    def carry(self, point: Array, horizon: int | None) -> None:
        super().carry(point, horizon)
        self._initial.clear()

    def with_hidden_starts(self, point: Array, horizon: int | None) -> Array:
        """The point: initial states are no part of it."""
        return point

    def _hidden_sizes(self) -> dict[int, float]:
        """Those of a simulation with the stabiliser, since states would diverge without."""
        if not self.hidden:
            return {}
        states = np.concatenate([item.states[:1] for item in self.experiments])
        starts = [
            [first, first, item.samples, 0] for first, item in zip(self.first_steps, self.experiments, strict=True)
        ]
        found = [self.simulated(self.system, np.array([row]), states[k : k + 1])[0] for k, row in enumerate(starts)]
        with np.errstate(over="ignore", invalid="ignore"):
            squares = [np.mean(run[:, self.hidden] ** 2, axis=0) for run in found]
        return root_mean_squares(self.hidden, squares)

    def simulated(self, system: System, starts: Starts, initial: Array) -> tuple[Array, Array]:
        """States and outputs of whole records with the stabiliser, since states that no record shows would diverge."""
        held, feedback = self._closed(system)
        given: dict[str, Any] = {"step": self.sampling.step, "every": self.sampling.every}
        return rollouts(system, starts, initial, held, **given, feedback=feedback)

    def _closed(self, system: System) -> tuple[Array, Array]:
        """The inputs of simulations with the stabiliser, and its feedback."""
        assert self._stabiliser is not None  # no window is closed without it
        held = np.concatenate([held_inputs(system, item, self._stabiliser) for item in self.experiments])
        return held, feedback_of(system, self._stabiliser)

    def relative_error(self, rows: Array) -> float:
        errors = rows[: len(rows) - len(self.priors(self.start))].reshape(-1, len(self._noise))
        return float(np.sqrt(np.mean((errors * self._noise / self.deviation) ** 2)))

    def chi_squared(self, rows: Array) -> float:
        """Mean squared error in units of the noise; 1 where noise alone is left."""
        return float(np.mean(rows[: len(rows) - len(self.priors(self.start))] ** 2))

    def weight(self, outputs: Array) -> Array:
        return np.asarray(1.0 / self._noise)

    def is_open(self, horizon: int | None) -> bool:
        return horizon is not None and horizon <= self._open

    def started(self, point: Array, horizon: int | None) -> tuple[System, Starts, Array]:
        starts, states, _, _ = self.windows(horizon)
        return self.with_point(point), starts, self._initial.get(horizon, states)

    def _setting(self, horizon: int | None) -> tuple[Starts, Array, Array, Array, dict[str, Any]]:
        """Windows: starts, measured initial states, outputs, inputs, and the settings of their simulation."""
        starts, states, outputs, _ = self.windows(horizon)
        given: dict[str, Any] = {"step": self.sampling.step, "every": self.sampling.every}
        if self.is_open(horizon):
            return starts, states, outputs, self.inputs, given
        held, given["feedback"] = self._closed(self.system)
        return starts, states, outputs, held, given

    def residuals(self, horizon: int | None) -> Residuals:
        """Errors of all windows in units of the noise, followed by the priors."""
        starts, states, outputs, inputs, given = self._setting(horizon)

        def evaluate(point: Array) -> Array:
            system = self.with_point(point)
            initial = self._initial.get(horizon, states)
            initial = settled(system, starts, initial, inputs, outputs, free=self._shown, noise=self._noise, **given)
            self._initial[horizon] = initial
            _, found = rollouts(system, starts, initial, inputs, **given)
            self.evaluations += 1
            errors = np.nan_to_num(np.clip((found - outputs) / self._noise, -1e6, 1e6), nan=1e6)
            return np.concatenate([errors.ravel(), self.priors(point)])

        return evaluate

    def jacobian(self, horizon: int | None, run: Map) -> Residuals:
        """Derivatives (rows, point), where the initial states follow the point."""
        starts, states, outputs, inputs, given = self._setting(horizon)
        sensitivities = Sensitivities(self.system, parameters=self.free, states=self._shown)
        count = outputs.shape[1]

        def evaluate(at: Array) -> Array:
            system = self.with_point(at)
            initial = settled(
                system, starts, self._initial.get(horizon, states), inputs, outputs,
                free=self._shown, noise=self._noise, **given,
            )  # fmt: skip
            jacobian = np.empty((len(outputs), count, sensitivities.count))
            sensitivities.rollouts(system, starts, initial, inputs, **given, out=jacobian)
            self.evaluations += 1
            jacobian = np.nan_to_num(np.clip(jacobian / self._noise[:, None], -1e6, 1e6))
            result = np.zeros((outputs.size + len(at), len(at)))
            for first, last in pairwise([*starts[:, 3], len(outputs)]):
                own = jacobian[first:last].reshape(-1, sensitivities.count)
                shared, by_start = own[:, : self.shared] * self.scales, own[:, self.shared :]
                basis = np.linalg.qr(by_start)[0]
                result[first * count : last * count] = shared - basis @ (basis.T @ shared)
            result[outputs.size :] = self.prior_jacobian
            return result

        return evaluate
