"""The residual of a gray box in training data, and where a model of it begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.core.symbolic import symbolic_values
from hybrid_sysid_ros.extensions.narx import term_selection
from hybrid_sysid_ros.extensions.narx.residual_hybrid import ResidualHybrid, Term, coefficients, step_up
from hybrid_sysid_ros.identification.initial_values import FEATURE_SCALE
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.hybrid_system import CLIP
from hybrid_sysid_ros.models.structure import Options
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SMOOTHED = 5
"""Samples over which a cubic smooths the measured residual: its differences are of noise otherwise."""

LASTING, LONG = 0.1, 50_000
"""What may be left of a residual after so many steps under a record's inputs, which are repeated for that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualSequence:
    """What a gray box leaves of an experiment, at every step of its simulation."""

    experiment: PreparedRecord
    states: Array
    """Of the gray box in free run, (steps + 1, states)."""
    errors: Array
    """Measured less simulated outputs, by cubic splines between the scored samples, (steps + 1, outputs)."""
    inputs: Array
    """Over each step, the last one twice, (steps + 1, inputs)."""

    @classmethod
    def of(cls, system: System, experiment: PreparedRecord) -> ResidualSequence:
        """By a fitted gray box."""
        sampling, steps = experiment.sampling, len(experiment.inputs)
        starts, first = np.array([[0, 0, steps + 1, 0]]), initial_state(system, experiment)[None]
        states, outputs = rollouts(system, starts, first, experiment.inputs, step=sampling.step)
        scored = np.arange(0, steps + 1, sampling.every)
        errors = savgol_filter(experiment.outputs - outputs[scored], SMOOTHED, 3, axis=0)
        return cls(
            experiment=experiment,
            states=states,
            errors=CubicSpline(scored, errors)(np.arange(steps + 1)),
            inputs=np.concatenate([experiment.inputs, experiment.inputs[-1:]]),
        )

    def states_of(self, system: ResidualHybrid) -> Array:
        """States (steps + 1, states) of a model with this residual behind it."""
        n = len(system.physics.declared_states)
        errors = [_earlier(values, lag) for values in self.errors.T for lag in range(system.output_lags)]
        past = [_earlier(values, lag) for values in self.inputs.T for lag in range(1, system.input_lags)]
        return np.column_stack([self.states[:, :n], *errors, *past, self.states[:, n:]])

    def initialised(self, system: ResidualHybrid) -> PreparedRecord:
        """The experiment with these states at its samples, where the short rollouts of a fit begin. The whole record
        begins without a residual.
        """
        states = np.ascontiguousarray(self.states_of(system)[:: self.experiment.sampling.every])
        n = len(system.physics.declared_states)
        states[0, n : n + len(system.reflections)] = 0.0
        return replace(self.experiment, states=states, deviations=None)


def initial_guess(physics: System, residuals: Sequence[ResidualSequence], options: Options) -> ResidualHybrid:
    """A model of the residual before its fit, beside a fitted gray box, and without a network.

    Its memory is that of the autocorrelation; its products are those by which forward regression explains most of one
    step, as of a NARX (:mod:`~.selection.term_selection`); coefficients are zero.
    """
    lags, outputs = int(options["output_lags"]), len(physics.outputs)
    shape = {
        "period": residuals[0].experiment.sampling.step,
        "output_lags": lags,
        "input_lags": int(options["input_lags"]),
        "units": 0,
        "exponents": ((),) * outputs,
    }
    bare = ResidualHybrid.of(physics, shape, np.zeros(0))
    values = [_regressors(bare, residual) for residual in residuals]
    scales = _sizes(np.concatenate(values), FEATURE_SCALE)
    rows = np.concatenate([value[lags - 1 : -1] for value in values]) / scales
    errors = [[residual.errors[:, i] for residual in residuals] for i in range(outputs)]
    reflections = [levinson(series, lags) for series in errors]
    changes = np.column_stack(
        [
            np.concatenate([_change(series, coefficients(own)) for series in several])
            for several, own in zip(errors, reflections, strict=True)
        ]
    )
    sizes = _sizes(changes)
    exponents = tuple(_terms(rows, change, len(bare.changes), options) for change in (changes / sizes).T)
    return replace(
        bare,
        exponents=exponents,
        reflections=tuple(value for own in reflections for value in own),
        scales=(*scales.tolist(), *sizes.tolist()),
        learned=np.zeros(sum(map(len, exponents))),
    )


def check_forgets(system: ResidualHybrid, residuals: Sequence[ResidualSequence]) -> None:
    """Raise UserError for a residual that lasts: bounded as it is, it could still swing by itself.

    Two free runs under a record's inputs, one of which begins with a residual of its deviation in the record, must have
    met after LONG steps but for LASTING of it.
    """
    n, lags = len(system.physics.declared_states), system.output_lags
    for residual in residuals:
        name, once = residual.experiment.name, residual.experiment.inputs
        inputs = np.tile(once, (-(-LONG // len(once)), 1))
        starts = np.array([[0, 0, len(inputs) + 1, row * (len(inputs) + 1)] for row in range(2)])
        first = np.repeat(residual.initialised(system).states[:1], 2, axis=0)
        sizes = np.std(residual.errors, axis=0)
        first[1, n : n + len(system.reflections)] += np.repeat(sizes, lags)
        states, _ = rollouts(system, starts, first, inputs, step=system.period)
        ends = states.reshape(2, len(inputs) + 1, -1)[:, -1, n : n + len(system.reflections) : lags]
        left = np.abs(ends[1] - ends[0]) / sizes
        worst = int(np.argmax(np.nan_to_num(left, nan=np.inf)))
        if not left[worst] <= LASTING:
            raise UserError(
                f"residual: {left[worst]:.0%} of a residual of {system.outputs[worst].name} is left after {LONG} steps "
                f"of {name}, more than {LASTING:.0%}: it does not die away; take fewer lags or units, or a larger ridge"
            )


def levinson(series: Sequence[Array], order: int) -> list[float]:
    """Reflection coefficients (order,) of the autocorrelation of several series (samples,).

    Levinson (1947), Durbin (1960); Markel and Gray (1976), Linear prediction of speech, section 5.1.
    """
    autocovariance = [sum(float(np.dot(v[: len(v) - lag], v[lag:])) for v in series) for lag in range(order + 1)]
    reflections: list[float] = []
    found: list[float] = []
    for m in range(1, order + 1):
        variance = autocovariance[0] - sum(a * autocovariance[j + 1] for j, a in enumerate(found))
        explained = autocovariance[m] - sum(a * autocovariance[m - 1 - j] for j, a in enumerate(found))
        reflections.append(float(np.clip(explained / variance, -1.0, 1.0)) if variance > 0.0 else 0.0)
        found = step_up(found, reflections[-1])
    return reflections


def _regressors(system: ResidualHybrid, residual: ResidualSequence) -> Array:
    """R at every step, (steps + 1, r), in its units."""
    found = symbolic_values(system, system.regressed)(residual.states_of(system).T, residual.inputs.T)
    return np.array(found).T


def _terms(rows: Array, target: Array, residuals: int, options: Options) -> tuple[Term, ...]:
    """All linear terms in what drives a residual, and the products that explain most of a step beside them.

    rows (steps, r), the last ``residuals`` columns of the residuals themselves; target (steps,).
    """
    degree, wanted, width = int(options["degree"]), int(options["terms"]), rows.shape[1]
    candidates = term_selection.exponents_of(width, degree) if degree else []
    linear = tuple(term for term in candidates if sum(term) < 2 and not any(term[width - residuals :]))
    products = [term for term in candidates if sum(term) > 1]
    if not products:
        return linear
    held = np.clip(rows, -CLIP, CLIP)
    further = np.stack([target, *(np.prod(held**term, axis=1) for term in products)], axis=1)
    known = np.stack([np.prod(rows**term, axis=1) for term in linear], axis=1)
    left = further - known @ np.linalg.lstsq(known, further, rcond=None)[0]
    chosen = term_selection.forward_selection(
        left[:, 1:], left[:, 0], min(len(products), len(rows) - 1, wanted or term_selection.MOST)
    )
    count = wanted or term_selection.least_criterion(left[:, 1:][:, chosen], left[:, 0])
    return (*linear, *(products[index] for index in chosen[:count]))


def _sizes(values: Array, share: float = 1.0) -> Array:
    """Root mean squares of columns."""
    return np.array([scale_of(share * float(np.sqrt(np.mean(column**2)))) for column in values.T])


def _earlier(values: Array, lag: int) -> Array:
    """A series ``lag`` samples ago; before the first one it is constant."""
    return np.concatenate([np.full(lag, values[0]), values[: len(values) - lag]])


def _change(values: Array, coefficients: Sequence[float]) -> Array:
    """Innovations of a series under autoregressive coefficients, (samples - lags,)."""
    lags, count = len(coefficients), len(values)
    predicted = [a * values[lags - 1 - j : count - 1 - j] for j, a in enumerate(coefficients)]
    return np.asarray(values[lags:] - np.sum(predicted, axis=0))
