"""The least-squares problem of a fit: errors of compiled rollouts, and priors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Sensitivities, System, rollouts
from hybrid_sysid_ros.identification.starts import RELATIVE_ERROR, hidden_sizes, shown_start, start_of, unshown_states
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Residuals = Callable[[Array], Array]
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]

CORRELATION_SECONDS = 1.0
"""Free-run errors are slow: so many seconds of them count as one observation against the priors."""

INITIAL_SPREAD = 0.1
"""Most prior deviation of a record's initial state from the measured one, relative to the state's deviation."""

SHARES = 4
"""Parts of one simulation with derivatives that may run in parallel."""

WIDEST = 10.0
"""Limit of hidden states that one simulation hands to the next, in their deviations, since it may still diverge."""


class FitProblem:
    """The residuals of one system on several experiments, as a function of one scaled vector, the point.

        free parameters, weights (both shared by all records) | initial states (of each record)

    Each output's errors are relative to its deviation. Initial states are nuisances with priors, as the rule of starts
    has them (:mod:`.starts`), so that the shared part does not have to explain them.
    """

    def __init__(
        self,
        system: System,
        experiments: Sequence[PreparedRecord],
        *,
        centres: Array | None = None,
        spreads: Array | None = None,
        ridge: float = 1.0,
        hold: Sequence[str] = (),
    ) -> None:
        """centres, spreads (free,): priors of the free parameters, in their units, instead of the declared ones. ridge:
        the prior deviation of weights is 1 / sqrt(ridge). hold: names of parameters that do not change.
        """
        if len({experiment.sampling for experiment in experiments}) > 1:
            raise UserError("identification: the records are sampled differently")
        self.system = system
        self.experiments = experiments
        self.sampling = experiments[0].sampling
        self.inputs = np.concatenate([experiment.inputs for experiment in experiments])
        self.first_steps = np.cumsum([0, *(len(experiment.inputs) for experiment in experiments)])[:-1]
        self.deviation = np.std(np.concatenate([item.outputs - item.outputs.mean(0) for item in experiments]), axis=0)
        _check_excitation(system, self.inputs, self.deviation)
        declared = system.parameters
        self.free = [index for index, item in enumerate(declared) if not item.fixed and item.name not in hold]
        self.scales = np.concatenate([[declared[i].scale for i in self.free], np.ones(len(system.weights))])
        self.low = np.concatenate([[declared[i].low for i in self.free], np.full(len(system.weights), -np.inf)])
        self.high = np.concatenate([[declared[i].high for i in self.free], np.full(len(system.weights), np.inf)])
        self.centres = np.array([declared[i].start for i in self.free]) if centres is None else centres
        self.spreads = np.array([declared[i].spread or np.inf for i in self.free]) if spreads is None else spreads
        self.ridge = ridge
        self.names = tuple(declared[i].name for i in self.free) + tuple(
            f"weight_{index}" for index in range(len(system.weights))
        )
        self.shared = len(self.scales)
        self.hidden = unshown_states(system)
        self._sizes = self._hidden_sizes()
        self._spread = np.array([self._sizes[i] for i in self.hidden])
        self._carried = [np.zeros((item.samples, len(self.hidden))) for item in experiments]
        first_states = [shown_start(system, item) for item in experiments]
        self._first, self.moved_states = [state for state, _ in first_states], first_states[0][1]
        self.lead = 0
        """Samples of each record that only show the inputs: those before it, which a delay lets act on its first
        samples, are in no record, and what they did would bend the parameters. None where states are hidden, whose
        rule of starts is about the first sample.
        """
        if self.sampling.initial == "estimated" and not self.hidden:
            self.lead = self.lead_of(system)
            self._first = [item.states[self.lead].copy() for item in experiments]
        units = self._units()
        self.nuisance_units = np.array([self._sizes.get(i, float(units[i])) for i in self.moved_states])
        """Prior deviation of each fitted initial state; record i has the value point[shared + state * records + i]."""
        self.without = slice(0, 0)
        """Rows of the residuals that do not count."""
        self.evaluations = 0
        self.confidence = 1.0
        """Factor of the errors' weight where they turn out to be smaller than expected."""

    def lead_of(self, system: System) -> int:
        """The lead that the delays of a system need."""
        if self.sampling.initial != "estimated" or self.hidden:
            return 0
        most = min(item.samples for item in self.experiments) // 2
        return min(math.ceil(np.max(system.input_delays, initial=0.0) / self.sampling.period), most)

    @property
    def start(self) -> Array:
        values = np.concatenate([self.system.values[self.free], self.system.weights]) / self.scales
        return np.concatenate([values, np.zeros(len(self.nuisance_units) * len(self.experiments))])

    @property
    def bounds(self) -> tuple[Array, Array]:
        nuisances = np.full(len(self.nuisance_units) * len(self.experiments), np.inf)
        return (
            np.concatenate([self.low / self.scales, -nuisances]),
            np.concatenate([self.high / self.scales, nuisances]),
        )

    def starts(self, count: int, seed: int) -> list[Array]:
        """Initial points: the declared start, and random ones around it by the parameters' scales."""
        random = np.random.default_rng(seed)
        lower, upper = self.bounds
        moves = [np.zeros(self.shared), *(random.normal(size=self.shared) for _ in range(count - 1))]
        nuisances = np.zeros(len(self.start) - self.shared)
        return [np.clip(self.start + np.concatenate([move, nuisances]), lower, upper) for move in moves]

    def relative_error(self, rows: Array) -> float:
        """Root mean square of the output errors in residual rows, relative to the output's deviation."""
        errors = rows[: len(rows) - len(self.priors(self.start))]
        seconds = sum(item.samples for item in self.experiments) * self.sampling.period
        count = np.sqrt(max(seconds / CORRELATION_SECONDS, 1.0))
        return float(np.linalg.norm(errors) * RELATIVE_ERROR / (count * self.confidence))

    def chi_squared(self, rows: Array) -> float | None:
        """Mean squared error in residual rows, where these are in units of the sensors' noise; else None."""
        return None

    def edges(self, horizon: int | None) -> NDArray[np.int64]:
        """Rows of the residuals where each record begins, and where the last one ends: (records + 1,)."""
        return self.windows(horizon)[3] * len(self.system.outputs)

    def with_point(self, point: Array) -> System:
        """The system at a point."""
        values = self.system.values
        shared = point[: self.shared] * self.scales
        values[self.free] = shared[: len(self.free)]
        system = self.system.with_values(values)
        return system.with_weights(shared[len(self.free) :]) if len(self.system.weights) else system

    def nuisances(self, point: Array) -> Array:
        """Corrections of the initial states of each record, (fitted states, records), in their units."""
        scaled = point[self.shared :].reshape(len(self.nuisance_units), len(self.experiments))
        return np.asarray(scaled * self.nuisance_units[:, None])

    def named_nuisances(self, point: Array) -> dict[str, Array]:
        """Corrections of the initial states, (records,) by the states' names."""
        names = (self.system.states[state].name for state in self.moved_states)
        return dict(zip(names, self.nuisances(point), strict=True))

    def priors(self, point: Array) -> Array:
        """Prior rows in units of their deviations: parameters less their centres, weights and nuisances."""
        physical = len(self.free)
        values = point[:physical] * self.scales[:physical]
        weights = np.sqrt(self.ridge) * point[physical : self.shared]
        return np.concatenate([(values - self.centres) / self.spreads, weights, point[self.shared :]])

    @property
    def prior_jacobian(self) -> Array:
        """Derivatives of the prior rows, (point, point)."""
        found = np.ones(len(self.start))
        physical = len(self.free)
        found[:physical] = self.scales[:physical] / self.spreads
        found[physical : self.shared] = np.sqrt(self.ridge)
        return np.diag(found)

    def prior_covariance(self, anchored: Array | None) -> Array:
        """Covariance of the prior rows (point, point), of deviation one but where they hold parameters near an earlier
        fit of the same records: ``anchored`` (free, free) is the covariance of that.
        """
        found, count = np.eye(len(self.start)), len(self.free)
        if anchored is not None and len(anchored) >= count:
            spreads = np.where(self.spreads > 0.0, self.spreads, np.inf)
            found[:count, :count] = anchored[:count, :count] / np.outer(spreads, spreads)
        return found

    def carry(self, point: Array, horizon: int | None) -> None:
        """Set initial states of rollouts within a record that no record shows, by a simulation at a point."""
        if not len(self.hidden) or horizon is None:
            return
        starts, states, _, edges = self.windows(None)
        system, initial = self.initialised(point, starts, states, edges)
        found, _ = self.simulated(system, starts, initial)
        held = np.clip(np.nan_to_num(found[:, self.hidden]), -WIDEST * self._spread, WIDEST * self._spread)
        self._carried = [held[begin:end] for begin, end in pairwise(edges)]

    def _units(self) -> Array:
        """Prior deviations (states,) of initial states from what the records show: they count like the errors, of which
        CORRELATION_SECONDS are one observation, and are at most a share of the state's deviation.
        """
        states = np.concatenate([item.states for item in self.experiments])
        most = np.maximum(INITIAL_SPREAD * np.std(states, axis=0), 1e-9)
        shown = [most if item.deviations is None else item.deviations for item in self.experiments]
        share = np.sqrt(max(CORRELATION_SECONDS / self.sampling.period, 1.0))
        return np.asarray(np.clip(share * np.sqrt(np.mean(np.square(shown), axis=0)), 1e-9, most))

    def with_hidden_starts(self, point: Array, horizon: int | None) -> Array:
        """A point whose initial states of what no record shows are those of the rule of starts, if they fit better."""
        moved = [self.moved_states.index(i) for i in self.hidden if i in self.moved_states]
        if not moved:
            return point
        system, trial = self.with_point(point), point.copy()
        changes = trial[self.shared :].reshape(len(self.moved_states), len(self.experiments))
        for record, (item, first) in enumerate(zip(self.experiments, self._first, strict=True)):
            found = start_of(system, item).state - first
            changes[moved, record] = [found[self.moved_states[k]] / self.nuisance_units[k] for k in moved]
        residuals = self.residuals(horizon)
        return trial if np.linalg.norm(residuals(trial)) < np.linalg.norm(residuals(point)) else point

    def _hidden_sizes(self) -> dict[int, float]:
        """Scales of states that no record shows, by index."""
        return hidden_sizes(self.system, self.experiments)

    def simulated(self, system: System, starts: NDArray[np.int64], initial: Array) -> tuple[Array, Array]:
        return rollouts(system, starts, initial, self.inputs, step=self.sampling.step, every=self.sampling.every)

    def windows(self, horizon: int | None) -> tuple[NDArray[np.int64], Array, Array, NDArray[np.int64]]:
        """Rollouts of ``horizon`` samples: starts (windows, 4), initial states (windows, states), outputs
        (samples, outputs), and the first row of each record (records + 1,).
        """
        starts, states, outputs, offset, edges = [], [], [], 0, [0]
        given = zip(self.first_steps, self.experiments, self._carried, self._first, strict=True)
        for first, experiment, carried, start in given:
            length = experiment.samples - 1 - self.lead
            length = length if horizon is None else min(horizon, length)
            for begin in range(self.lead, experiment.samples - length, length):
                starts.append((first, first + begin * self.sampling.every, length + 1, offset))
                state = experiment.states[begin].copy() if begin > self.lead else start
                if begin > self.lead:
                    state[self.hidden] = carried[begin]
                states.append(state)
                outputs.append(experiment.followed[begin : begin + length + 1])
                offset += length + 1
            edges.append(offset)
        return np.array(starts, dtype=np.int64), np.array(states), np.concatenate(outputs), np.array(edges)

    def weight(self, outputs: Array) -> Array:
        """Weights (outputs,) of the errors of outputs (samples, outputs), see :data:`CORRELATION_SECONDS`."""
        seconds = len(outputs) * self.sampling.period
        scale = np.sqrt(max(seconds / CORRELATION_SECONDS, 1.0) / outputs.size)
        return np.asarray(self.confidence * scale / (RELATIVE_ERROR * self.deviation))

    def initialised(
        self, point: Array, starts: NDArray[np.int64], states: Array, edges: NDArray[np.int64]
    ) -> tuple[System, Array]:
        """System and initial states (windows, states) at a point."""
        begins = np.flatnonzero(np.isin(starts[:, 3], edges[:-1]))
        states = states.copy()
        states[begins[:, None], self.moved_states] += self.nuisances(point).T
        return self.with_point(point), states

    def started(self, point: Array, horizon: int | None) -> tuple[System, NDArray[np.int64], Array]:
        """System, starts (windows, 4) and initial states (windows, states) of the rollouts at a point."""
        starts, states, _, edges = self.windows(horizon)
        system, initial = self.initialised(point, starts, states, edges)
        return system, starts, initial

    def is_open(self, horizon: int | None) -> bool:
        """Whether nothing but the records' inputs acts in the rollouts."""
        return True

    def residuals(self, horizon: int | None) -> Residuals:
        """Weighted output errors of all rollouts, followed by the priors."""
        starts, states, outputs, edges = self.windows(horizon)
        weight = self.weight(outputs)

        def evaluate(point: Array) -> Array:
            system, initial = self.initialised(point, starts, states, edges)
            _, out = self.simulated(system, starts, initial)
            self.evaluations += 1
            # A diverging simulation must repel the search, not stop it.
            with np.errstate(over="ignore", invalid="ignore"):
                errors = ((out - outputs) * weight).ravel()
            errors = np.nan_to_num(np.clip(errors, -1e6, 1e6), nan=1e6)
            errors[self.without] = 0.0
            return np.concatenate([errors, self.priors(point)])

        return evaluate

    def jacobian(self, horizon: int | None, run: Map) -> Residuals:
        """Exact derivatives (rows, point) from one simulation with sensitivities. ``run`` maps a function over its
        parts, in parallel or not.
        """
        records = len(self.experiments)
        starts, states, outputs, edges = self.windows(horizon)
        rows, count = outputs.size, outputs.shape[1]
        weight = self.weight(outputs)
        sensitivities = Sensitivities(self.system, parameters=self.free, states=self.moved_states)
        shares = np.array_split(starts, min(SHARES, len(starts)))
        begins = np.isin(starts[:, 3], edges[:-1])
        inside = np.repeat(begins, starts[:, 2])

        def tangent(at: Array) -> Array:
            """Weighted derivatives (samples, outputs, columns)."""
            system, initial = self.initialised(at, starts, states, edges)
            out = np.empty((len(outputs), count, sensitivities.count))

            def simulate(share: NDArray[np.int64]) -> None:
                at = np.searchsorted(starts[:, 3], share[:, 3])
                sensitivities.rollouts(
                    system, share, initial[at], self.inputs, step=self.sampling.step, every=self.sampling.every, out=out
                )

            list(run(simulate, shares))
            self.evaluations += 1
            out *= weight[:, None]
            np.clip(out, -1e6, 1e6, out=out)
            out[np.isnan(out)] = 0.0
            return out

        def evaluate(at: Array) -> Array:
            result = np.zeros((rows + len(at), len(at)))
            out = tangent(at)
            by_sample = result[:rows].reshape(*out.shape[:2], len(at))
            np.multiply(out[:, :, : self.shared], self.scales, out=by_sample[:, :, : self.shared])
            for kind, unit in enumerate(self.nuisance_units):
                change = unit * out[:, :, self.shared + kind] * inside[:, None]
                for record in range(records):
                    part = slice(edges[record], edges[record + 1])
                    place = self.shared + kind * records + record
                    result[part.start * count : part.stop * count, place] = change[part].ravel()
            result[self.without] = 0.0
            result[rows:] = self.prior_jacobian
            return result

        return evaluate


def _check_excitation(system: System, inputs: Array, deviation: Array) -> None:
    for output, value in enumerate(deviation):
        if value < 1e-9:
            name = system.outputs[output].name
            raise UserError(f"identification: output {name} is constant in every record; nothing to identify")
    for column in range(inputs.shape[1]):
        if np.ptp(inputs[:, column]) < 1e-9:
            name = system.inputs[column].name
            raise UserError(f"identification: input {name} is constant in every record; excite the rig")
