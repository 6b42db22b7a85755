"""Starts: the state at which a simulation of a record begins, by one rule for fits and scores.

What a record shows of its first state is known within the sensors' noise, and what it does not show within what the
state is worth in a simulation. The outputs of the first samples decide the rest, in a damped least-squares search
(Levenberg-Marquardt) from several beginnings:

    min over x0  sum_k |(y_k - y(x0, u)_k) / s|^2 + |(x0 - x_shown) / d|^2

s: the larger of noise and error of the run, so that the start does not bend to explain an error of the model. All
beginnings are searched at once, since one compiled call simulates them all; scipy's least_squares knows one point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Recurrence, Sensitivities, System, rollouts
from hybrid_sysid_ros.core.rollout import Starts
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BEGINNINGS = 8
"""Beginnings of the search where a record does not show some states."""
ITERATIONS, STILL = 30, 1e-6
"""Most iterations of a search, and the relative change of the cost that ends it."""
RELATIVE_ERROR = 0.05
"""Expected error of a free run in the output's deviation, until a run says more; fits weight data against priors by it.
"""
WIDE = 10.0
"""Prior deviation of a state that no record shows, in its root mean square over a simulation."""
FAILED = 1e9
"""Error of a run that diverges."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialState:
    """The first state of a simulation, and how well it is known."""

    state: Array
    """(states,)."""
    estimated: tuple[int, ...]
    """Indices of the estimated states."""
    covariance: Array
    """Of these, (estimated, estimated)."""


def initial_state(system: System, experiment: PreparedRecord) -> Array:
    """The state (states,) at which a simulation of a record begins, see :func:`start_of`."""
    return start_of(system, experiment).state


def start_of(system: System, experiment: PreparedRecord) -> InitialState:
    """The start of a record by its sampling: ``initial`` says what is known, the first ``initial_samples`` samples
    decide the rest. Raises UserError for a given value of a state that the system has not.
    """
    state, free = shown_start(system, experiment)
    if not free:
        return InitialState(state=state, estimated=(), covariance=np.zeros((0, 0)))
    sizes, deviations = hidden_sizes(system, [experiment]), experiment.deviations
    scales = np.array([sizes[i] if i in sizes or deviations is None else deviations[i] for i in free])
    priors = np.array([1.0 / WIDE if i in sizes else 1.0 for i in free])
    return _searched(system, experiment, state, free, scales, priors)


def shown_start(system: System, experiment: PreparedRecord) -> tuple[Array, list[int]]:
    """A first state (states,), and the indices of the states in it that are still to be estimated.

    Raises UserError for a given value of a state that the system has not.
    """
    state, sampling = experiment.states[0].copy(), experiment.sampling
    hidden = unshown_states(system)
    given = isinstance(system, Recurrence) or experiment.deviations is None
    shown = [] if given else shown_states(system)
    if sampling.initial == "first":
        return state, hidden
    if sampling.initial == "rest":
        known = system.record_map().reconstructible
        rates = [i for i, (_, rate) in known.items() if rate and i in shown]
        state[[*rates, *hidden]] = 0.0
        return state, []
    names, free = [item.name for item in system.states], [*shown, *hidden]
    for name, value in sampling.given.items():
        if name not in names:
            raise UserError(f"initial: there is no state {name}; the model's states are {', '.join(names)}")
        state[names.index(name)] = value
        free = [i for i in free if i != names.index(name)]
    return state, free


def shown_states(system: System) -> list[int]:
    """States whose initial values a record shows within noise; of a delay line only the outputs, since the record shows
    the rest.
    """
    known = system.record_map()
    return sorted(i for i, (_, rate) in known.reconstructible.items() if not (rate and i in known.delay_line))


def unshown_states(system: System) -> list[int]:
    """States that records don't show, including hidden states of contacts."""
    deflections = range(len(system.declared_states), len(system.states))
    known = system.record_map()
    rest = [i for i in deflections if i not in known.reconstructible and i not in known.delay_line]
    return [*known.unobserved, *rest]


def hidden_sizes(system: System, experiments: Sequence[PreparedRecord]) -> dict[int, float]:
    """Root mean squares of the states that records don't show in a simulation, by index; 1 for those that are zero
    there, such as biases of inputs, which have scales of their own, and for those that diverge.
    """
    hidden, squares = unshown_states(system), []
    if not hidden:
        return {}
    for item in experiments:
        first, given = np.nan_to_num(item.states[:1].copy()), item.sampling
        starts = np.array([[0, 0, item.samples, 0]])
        states, _ = rollouts(system, starts, first, item.inputs, step=given.step, every=given.every)
        with np.errstate(over="ignore", invalid="ignore"):
            squares.append(np.mean(states[:, hidden] ** 2, axis=0))
    return root_mean_squares(hidden, squares)


def root_mean_squares(hidden: Sequence[int], squares: Sequence[Array]) -> dict[int, float]:
    """Usable sizes by index, from the mean squares (hidden,) of each record; else 1."""
    values = np.sqrt(np.mean(squares, axis=0))
    usable = np.isfinite(values) & (values > 1e-9) & (values < 1e6)
    return dict(zip(hidden, np.where(usable, values, 1.0).tolist(), strict=True))


def _searched(
    system: System, experiment: PreparedRecord, state: Array, free: Sequence[int], scales: Array, priors: Array
) -> InitialState:
    """The start in which ``free`` states fit the first samples; scales (free,) of their changes, priors (free,) the
    reciprocal deviations of these in the scales.
    """
    count = min(experiment.sampling.initial_samples + 1, experiment.samples)
    measured, deviation = experiment.outputs[:count], np.maximum(np.std(experiment.outputs, axis=0), 1e-12)
    noise = deviation * 1e-6 if experiment.noise is None else np.maximum(experiment.noise, 1e-6 * deviation)
    moves, unknown = np.zeros((1, len(free))), [i for i, prior in zip(free, priors, strict=True) if prior < 1.0]
    if unknown and not np.any(state[unknown]):  # nothing is known, not even by an encoder
        random = np.random.default_rng(0).normal(size=(BEGINNINGS - 1, len(free)))
        moves = np.concatenate([moves, random * np.where(priors < 1.0, 2.0, 0.0)])
    problem = _StartProblem(system, experiment, state, free, scales, priors, measured)
    errors = np.maximum(noise, RELATIVE_ERROR * deviation)
    moves, costs = problem.search(moves, errors)
    best = int(np.argmin(costs))
    found, _ = problem.residuals(moves[best : best + 1])
    errors = np.maximum(noise, np.sqrt(np.mean(np.minimum(np.abs(found[0]), FAILED * deviation) ** 2, axis=0)))
    moves, _ = problem.search(moves[best : best + 1], errors)
    normal = problem.normal(moves, errors)[0][0]
    change = moves[0] * scales
    state = state.copy()
    if np.isfinite(change).all():
        state[list(free)] += change
    covariance = np.linalg.pinv(normal, hermitian=True) * np.outer(scales, scales)
    return InitialState(state=state, estimated=tuple(free), covariance=covariance)


@dataclass(frozen=True, eq=False)
class _StartProblem:
    """Runs over a record's first samples from several beginnings at once; moves (beginnings, free) are in scales."""

    system: System
    experiment: PreparedRecord
    state: Array
    free: Sequence[int]
    scales: Array
    priors: Array
    measured: Array
    """(samples, outputs)."""

    def _setting(self, moves: Array) -> tuple[Starts, Array, dict[str, Any]]:
        count, sampling = len(self.measured), self.experiment.sampling
        starts = np.array([[0, 0, count, k * count] for k in range(len(moves))])
        first = np.repeat(self.state[None], len(moves), axis=0)
        first[:, list(self.free)] += moves * self.scales
        return starts, first, {"step": sampling.step, "every": sampling.every}

    def residuals(self, moves: Array) -> tuple[Array, Array]:
        """Errors (beginnings, samples, outputs) in the outputs' units, and their first states."""
        starts, first, given = self._setting(moves)
        _, outputs = rollouts(self.system, starts, first, self.experiment.inputs, **given)
        found = outputs.reshape(len(moves), *self.measured.shape) - self.measured
        if self.experiment.measured is not None:
            found[:, ~self.experiment.measured[: len(self.measured)]] = 0.0
        return found, first

    def costs(self, moves: Array, errors: Array) -> Array:
        """(beginnings,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = self.residuals(moves)[0] / errors
            squares = np.sum(np.clip(np.nan_to_num(found, nan=FAILED), -FAILED, FAILED) ** 2, axis=(1, 2))
        return np.asarray(squares + np.sum((self.priors * moves) ** 2, axis=1))

    def normal(self, moves: Array, errors: Array) -> tuple[Array, Array]:
        """J'J (beginnings, free, free) and J'e (beginnings, free), priors included."""
        starts, first, given = self._setting(moves)
        sensitivities = Sensitivities(self.system, parameters=(), states=list(self.free), learn=False)
        out = np.empty((len(moves) * len(self.measured), self.measured.shape[1], sensitivities.count))
        sensitivities.rollouts(self.system, starts, first, self.experiment.inputs, **given, out=out)
        jacobian = out.reshape(len(moves), *self.measured.shape, len(self.free))
        with np.errstate(over="ignore", invalid="ignore"):
            jacobian = np.clip(np.nan_to_num(jacobian * (self.scales / errors[:, None])), -FAILED, FAILED)
            found = np.clip(np.nan_to_num(self.residuals(moves)[0] / errors, nan=FAILED), -FAILED, FAILED)
        if self.experiment.measured is not None:
            jacobian[:, ~self.experiment.measured[: len(self.measured)]] = 0.0
        matrix = np.einsum("bkoi,bkoj->bij", jacobian, jacobian) + np.diag(self.priors**2)
        return matrix, np.einsum("bkoi,bko->bi", jacobian, found) + self.priors**2 * moves

    def search(self, moves: Array, errors: Array) -> tuple[Array, Array]:
        """Levenberg-Marquardt from several moves at once: the moves (beginnings, free) at the ends and their costs."""
        moves, costs, damping = moves.copy(), self.costs(moves, errors), np.full(len(moves), 1e-3)
        for _ in range(ITERATIONS):
            matrix, gradient = self.normal(moves, errors)
            damped = matrix + damping[:, None, None] * (matrix * np.eye(len(self.free)))
            trial = moves - np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
            tried = self.costs(trial, errors)
            better = tried < costs
            still = np.where(better, costs - tried <= STILL * costs, damping > 1e6)
            moves[better], costs[better] = trial[better], tried[better]
            damping = np.where(better, np.maximum(damping / 10.0, 1e-9), damping * 10.0)
            if still.all():
                break
        return moves, costs
