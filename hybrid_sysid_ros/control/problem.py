"""The control problem of an MPC: its cost and its bounds, and the cost of a stage, which is written once.

The MPC, checks of its imitations, certificates and scores of whole loops use the same cost.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.terms import StageTerm, check_terms, terms_of, with_terms
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError, known
from hybrid_sysid_ros.support.structured import numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class StageWeights(Shared):
    """Weights of stage costs for n states, m inputs, and r values: p outputs and the terms behind them."""

    outputs: Array
    """Weights of the values' squared errors, (stages, r) [1/unit^2]."""
    prices: Array
    """Prices of the values, (stages, r) [1/unit]."""
    rates: Array
    """Weights of squared changes, (stages, m)."""
    inputs: Array
    """Weights of squared inputs, (stages, m)."""
    low: Array
    """Lower bounds of the states, (n,); -inf: none."""
    high: Array
    """(n,)."""
    linear: Array
    """(n,); a state that is outside by s costs linear s + quadratic s^2."""
    quadratic: Array
    """(n,)."""
    value_low: Array
    """Lower bounds of the values, (stages, r)."""
    value_high: Array
    """(stages, r)."""
    value_linear: Array
    """(r,), as of the states."""
    value_quadratic: Array
    """(r,)."""


@inner
def stage_cost(weights: Any, i: int, y: Any, q: Any, u: Any, before: Any, x: Any) -> float:
    """Cost of stage i with values y (r,), references q (p,) of the outputs and states x (n,) at its end, inputs u (m,)
    and previous inputs ``before`` (m,).
    """
    cost = 0.0
    for k in range(q.shape[0]):
        error = y[k] - q[k]
        cost += weights.outputs[i, k] * error * error
    for j in range(u.shape[0]):
        change = u[j] - before[j]
        cost += weights.rates[i, j] * change * change + weights.inputs[i, j] * u[j] * u[j]
    for a in range(x.shape[0]):
        s = excess(weights, a, x[a])
        cost += (weights.linear[a] + weights.quadratic[a] * s) * s
    for k in range(q.shape[0], y.shape[0]):
        s = max(y[k] - weights.value_high[i, k], weights.value_low[i, k] - y[k], 0.0)
        cost += (weights.outputs[i, k] * y[k] + weights.prices[i, k]) * y[k]
        cost += (weights.value_linear[k] + weights.value_quadratic[k] * s) * s
    return cost


@inner
def excess(weights: Any, a: int, value: float) -> float:
    """Distance of state a from its bounds, 0 within them."""
    return max(value - weights.high[a], weights.low[a] - value, 0.0)


@kernel
def _stage_costs(
    weights: StageWeights, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array, out: Array
) -> None:
    for k in range(out.shape[0]):
        before = previous if k == 0 else inputs[k - 1]
        out[k] = stage_cost(weights, 0, outputs[k], references[k], inputs[k], before, states[k])


def stage_costs(
    problem: ControlProblem, *, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array
) -> Array:
    """Cost (samples,) of each stage of a loop.

    outputs (samples, p), or with the terms behind them (samples, r), references (samples, p), inputs (samples, m),
    states (samples, n): each row one stage, see :func:`stage_cost`. previous (m,): the inputs before the first row. The
    problem is sized.
    """
    rows = [np.ascontiguousarray(part, dtype=float) for part in (outputs, references, inputs, previous, states)]
    costs = np.empty(len(rows[0]))
    _stage_costs(problem.stage_weights, *rows, costs)
    return costs


_PER_OUTPUT = ("output_weights", "output_scales")
_PER_INPUT = ("rate_weights", "input_weights", "input_low", "input_high", "rate_limits")
_PER_STATE = ("state_low", "state_high", "soft_linear", "soft_quadratic")
_POSITIVE = ("horizon", "period", "substeps", "max_iterations", "output_scales", "soft_quadratic", "rate_limits")
_WHOLE = ("horizon", "substeps", "max_iterations")
_NOT_NEGATIVE = ("output_weights", "final_output_weights", "rate_weights", "input_weights", "soft_linear", "smoothing")


@dataclass(frozen=True, kw_only=True)
class ControlProblem:
    """The problem of a system with n states, m inputs and p outputs, over the inputs u_0..u_{N-1}.

    Minimise
        sum_{i=1}^{N}    sum_k output_weights_k ((y_ik - q_ik) / output_scales_k)^2
      + sum_{i=0}^{N-1}  sum_j rate_weights_j (u_ij - u_{i-1,j})^2 + input_weights_j u_ij^2
      + sum_{i=1}^{N}    sum_a soft_linear_a s_ia + soft_quadratic_a s_ia^2

    and the terms of each stage (:class:`~.terms.StageTerm`), with x_{i+1} = step(x_i, u_i + d),
    y_{i+1} = output(x_{i+1}, u_i + d), input_low <= u_i <= input_high, |u_i - u_{i-1}| <= rate_limits, and s_ia the
    distance of a state from its bounds.

    A tuple of one value holds for every output, input or state; :meth:`sized` writes it out.
    """

    horizon: int
    """N."""
    period: float
    """Length of one interval [s]."""
    substeps: int
    """Integration steps in an interval."""
    output_weights: Numbers
    """(p,); an output of weight 0 is not tracked."""
    input_low: Numbers
    """(m,) [unit of each input]."""
    input_high: Numbers
    """(m,)."""
    output_scales: Numbers = (1.0,)
    """(p,), the unit in which each output is weighted [SI]."""
    rate_weights: Numbers = (0.0,)
    """(m,) of changes [1/unit^2]."""
    input_weights: Numbers = (0.0,)
    """(m,) [1/unit^2]."""
    rate_limits: Numbers = (math.inf,)
    """(m,), largest change from one interval to the next."""
    state_low: Numbers = (-math.inf,)
    """(n,), soft bounds."""
    state_high: Numbers = (math.inf,)
    """(n,)."""
    soft_linear: Numbers = (0.0,)
    """(n,), price of a state outside its bounds, per distance [1/unit]."""
    soft_quadratic: Numbers = (1e4,)
    """(n,), price per squared distance [1/unit^2]."""
    final_output_weights: Numbers = ()
    """(p,) at the end of the horizon; empty: as output_weights."""
    terms: tuple[StageTerm, ...] = ()
    """Further terms of each stage, also as a mapping {name: {value: formula, price: 1.0}}."""
    stage_parameters: tuple[tuple[str, Numbers], ...] = ()
    """Names of parameters in the terms' formulas, also as a mapping, with a value for all stages or N values."""
    smoothing: float = 0.0
    """Smoothing of stick-slip [unit of the velocity]."""
    max_iterations: int = 100
    """Most iterations of the solver."""

    def __post_init__(self) -> None:
        for name in (*_PER_OUTPUT, *_PER_INPUT, *_PER_STATE):
            object.__setattr__(self, name, _numbers(name, getattr(self, name)))
        object.__setattr__(self, "terms", terms_of(self.terms))
        object.__setattr__(self, "stage_parameters", _stage_parameters(self.stage_parameters, self.horizon))
        final = self.final_output_weights
        final = _numbers("final_output_weights", final) if np.size(final) else ()
        object.__setattr__(self, "final_output_weights", final)
        for term in self.terms:
            for each in (term.weight, term.price):
                if np.size(each) not in (1, self.horizon):
                    raise UserError(
                        f"mpc: term {term.name} has {np.size(each)} weights or prices; "
                        f"it needs one, or one for each of the {self.horizon} stages"
                    )
        for name in _WHOLE:
            if not isinstance(getattr(self, name), int):
                raise UserError(f"mpc: {name} is {getattr(self, name)!r}; it must be a whole number")
        for name in (*_POSITIVE, *_NOT_NEGATIVE, "input_low", "input_high"):
            values = np.atleast_1d(getattr(self, name))
            sound = values > 0.0 if name in _POSITIVE else values >= (0.0 if name in _NOT_NEGATIVE else -math.inf)
            if not np.all(sound & (np.isfinite(values) | (name == "rate_limits"))):
                least = "above 0" if name in _POSITIVE else "at least 0" if name in _NOT_NEGATIVE else "finite"
                raise UserError(f"mpc: {name} is {getattr(self, name)}; it must be {least}")
        if not (any(self.output_weights) or self.terms):
            raise UserError("mpc: all output_weights are 0, so there is nothing to track; give one output a weight")
        for kind in ("input", "state"):
            low, high = getattr(self, f"{kind}_low"), getattr(self, f"{kind}_high")
            alike = len(low) == len(high) or 1 in (len(low), len(high))
            if not alike or not np.all(np.array(low) < np.array(high)):
                raise UserError(f"mpc: {kind}_low {low} is not below {kind}_high {high} everywhere")

    def sized(self, system: System) -> ControlProblem:
        """The problem with a value for each output, input and state of a system.

        Raises UserError where it has another number of values, or steps that are not the problem's.
        """
        own, step = system.sampling_time, self.period / self.substeps
        if own is not None and abs(step - own) > 1e-9:
            raise UserError(
                f"mpc: {type(system).__name__} steps by {own:g} s, the problem by {step:g} s: set mpc's period to "
                f"whole steps of the model and its substeps to their number, or identify with that period (--period)"
            )
        each = (_PER_OUTPUT, system.outputs), (_PER_INPUT, system.inputs), (_PER_STATE, system.states)
        found = {
            name: numbers(getattr(self, name), f"mpc: {name} of {type(system).__name__}", count=len(of))
            for names, of in each
            for name in names
        }
        if self.final_output_weights:
            names = f"mpc: final_output_weights of {type(system).__name__}"
            found["final_output_weights"] = numbers(self.final_output_weights, names, count=len(system.outputs))
        check_terms(system, self.terms, [name for name, _ in self.stage_parameters])
        return dataclasses.replace(self, **found)  # type: ignore[arg-type]

    def outputs_of(self, system: System, *, curvature: bool = False) -> System:
        """The system whose outputs are the values of a stage; the system itself where there are no terms."""
        return with_terms(system, self.terms, [name for name, _ in self.stage_parameters], curvature=curvature)

    @property
    def stage_values(self) -> Array:
        """Values (N, q) of the stage's parameters."""
        columns = [np.broadcast_to(np.array(values), (self.horizon,)) for _, values in self.stage_parameters]
        return np.column_stack(columns) if columns else np.zeros((self.horizon, 0))

    def assign(self, stage: Array, values: Mapping[str, Any]) -> None:
        """Write values of the stage's parameters, one or N each, to their columns in ``stage`` (N, q).

        Raises UserError for an unknown name and for values that don't cover the horizon.
        """
        names = [name for name, _ in self.stage_parameters]
        for name in values:
            if name not in names:
                raise UserError(f"mpc: there is no stage parameter {name}: {known(name, names)}")
        for name, sound in _stage_parameters(values, self.horizon):
            stage[:, names.index(name)] = sound

    @property
    def weights(self) -> StageWeights:
        """Weights of the horizon's stages, for a problem that is :meth:`sized`."""
        return self._weights(self.horizon)

    @property
    def stage_weights(self) -> StageWeights:
        """Weights of one stage, for whole loops, for a problem that is :meth:`sized`."""
        return _stage_weights(self)

    def _weights(self, stages: int) -> StageWeights:
        outputs = np.tile(np.array(self.output_weights) / np.array(self.output_scales) ** 2, (stages, 1))
        if self.final_output_weights and stages == self.horizon:
            outputs[-1] = np.array(self.final_output_weights) / np.array(self.output_scales) ** 2
        terms, none = self.terms, np.zeros(outputs.shape)
        return StageWeights(
            outputs=np.hstack([outputs, *(self._staged(term, term.weight, 0.0, stages) for term in terms)]),
            prices=np.hstack([none, *(self._staged(term, term.price, 0.0, stages) for term in terms)]),
            rates=np.tile(self.rate_weights, (stages, 1)),
            inputs=np.tile(self.input_weights, (stages, 1)),
            low=np.array(self.state_low),
            high=np.array(self.state_high),
            linear=np.array(self.soft_linear),
            quadratic=np.array(self.soft_quadratic),
            value_low=np.hstack(
                [none - math.inf, *(self._staged(term, term.low, -math.inf, stages) for term in terms)]
            ),
            value_high=np.hstack(
                [none + math.inf, *(self._staged(term, term.high, math.inf, stages) for term in terms)]
            ),
            value_linear=np.concatenate([none[0], [term.soft_linear for term in terms]]),
            value_quadratic=np.concatenate([none[0], [term.soft_quadratic for term in terms]]),
        )

    def _staged(self, term: StageTerm, values: Numbers | float, without: float, stages: int) -> Array:
        """A column (stages, 1) of a term's values; ``without`` where it does not count."""
        found = np.broadcast_to(np.array(values, dtype=float), (self.horizon,)).copy()
        if term.final:
            found[:-1] = without
        return found[:stages, None]


@lru_cache
def _stage_weights(problem: ControlProblem) -> StageWeights:
    return problem._weights(1)


def _numbers(name: str, values: Any) -> Numbers:
    """A tuple of numbers from a value of a file or a caller. Raises UserError for other values."""
    try:
        found = tuple(float(value) for value in (values if isinstance(values, Sequence | np.ndarray) else (values,)))
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"mpc: {name} is {values!r}; it needs numbers") from error
    if not found or any(math.isnan(value) for value in found):
        raise UserError(f"mpc: {name} is {values!r}; it needs numbers")
    return found


def _stage_parameters(given: Any, horizon: int) -> tuple[tuple[str, Numbers], ...]:
    """Names and values of the stage's parameters. Raises UserError for values that don't cover the horizon."""
    pairs = list(given.items()) if isinstance(given, Mapping) else given
    if not isinstance(pairs, list | tuple) or not all(
        isinstance(pair, list | tuple) and len(pair) == 2 for pair in pairs
    ):
        raise UserError(f"mpc: stage_parameters is {given!r}; give names with values, such as {{limit: 1.0}}")
    found: list[tuple[str, Numbers]] = []
    for name, values in pairs:
        if str(name) in dict(found):
            raise UserError(f"mpc: stage parameter {name} is there twice")
        sound = _numbers(f"stage parameter {name}", values)
        if not all(map(math.isfinite, sound)):
            raise UserError(f"mpc: stage parameter {name} is not finite")
        if len(sound) not in (1, horizon):
            raise UserError(
                f"mpc: stage parameter {name} has {len(sound)} values; it needs one, or {horizon}, one for each stage"
            )
        found.append((str(name), sound))
    return tuple(found)
