"""The control problem of an MPC: its cost and its bounds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.stage_cost import StageWeights
from hybrid_sysid_ros.control.terms import StageTerm, check_hard, check_terms, terms_of, with_terms
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError, known
from hybrid_sysid_ros.support.structured import numbers

_PER_OUTPUT = ("output_weights", "output_scales")
_PER_INPUT = ("rate_weights", "input_weights", "input_rest", "input_low", "input_high", "rate_limits")
_PER_STATE = ("state_low", "state_high", "soft_linear", "soft_quadratic")
_POSITIVE = ("horizon", "period", "substeps", "max_iterations", "output_scales", "soft_quadratic", "rate_limits")
_WHOLE = ("horizon", "substeps", "max_iterations")
_NOT_NEGATIVE = ("output_weights", "final_output_weights", "rate_weights", "input_weights", "soft_linear", "smoothing")


@dataclass(frozen=True, kw_only=True)
class ControlProblem:
    """The problem of a system with n states, m inputs and p outputs, over the inputs u_0..u_{N-1}.

    Minimise
        sum_{i=1}^{N}    sum_k output_weights_k ((y_ik - q_ik) / output_scales_k)^2
      + sum_{i=0}^{N-1}  sum_j rate_weights_j (u_ij - u_{i-1,j})^2 + input_weights_j (u_ij - input_rest_j)^2
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
    input_rest: Numbers = (0.0,)
    """(m,), inputs that cost nothing, such as those at an operating point."""
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
    intervals: tuple[int, ...] = ()
    """Lengths of uneven intervals [periods]; empty: all 1. Outputs, states and terms count at their ends, with weights
    and prices times their lengths, but for those at the end of the horizon alone.
    """
    blocks: tuple[int, ...] = ()
    """Numbers of periods through which inputs are held, the last one to the end; empty: those of ``intervals``."""
    terms: tuple[StageTerm, ...] = ()
    """Further terms of each stage, also as a mapping {name: {value: formula, price: 1.0}}."""
    stage_parameters: tuple[tuple[str, Numbers], ...] = ()
    """Names of parameters in the terms' formulas, also as a mapping, with a value for all stages or N values."""
    state_margins: tuple[Numbers, ...] = ()
    """By how much the bounds of each state are moved in at each stage, (n, N); costs of loops don't know it.
    Empty: not at all.
    """
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
        for name in ("intervals", "blocks"):
            object.__setattr__(self, name, _lengths(name, getattr(self, name), self.horizon))
        object.__setattr__(self, "state_margins", tuple(_numbers("state_margins", each) for each in self.state_margins))
        for name in _WHOLE:
            if not isinstance(getattr(self, name), int):
                raise UserError(f"mpc: {name} is {getattr(self, name)!r}; it must be a whole number")
        for name in (*_POSITIVE, *_NOT_NEGATIVE, "input_rest", "input_low", "input_high"):
            values = np.atleast_1d(getattr(self, name))
            sound = values > 0.0 if name in _POSITIVE else values >= (0.0 if name in _NOT_NEGATIVE else -math.inf)
            if not np.all(sound & (np.isfinite(values) | (name == "rate_limits"))):
                least = "above 0" if name in _POSITIVE else "at least 0" if name in _NOT_NEGATIVE else "finite"
                raise UserError(f"mpc: {name} is {getattr(self, name)}; it must be {least}")
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
                f"mpc: {type(system).__name__} steps by {own:g} s, the problem by {step:g} s: set the controller's "
                "period to whole steps of the model and its substeps to their number, or identify with that period "
                "(--period)"
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
        sized = dataclasses.replace(self, **found)  # type: ignore[arg-type]
        stage = [name for name, _ in self.stage_parameters]
        check_terms(system, self.terms, stage)
        check_hard(system, self.terms, stage, self.stage_values, sized.input_low, sized.input_high)
        bounds = zip(system.states, sized.state_margins, sized.state_low, sized.state_high, strict=False)
        for name, margins, low, high in (
            *((item.name, *each) for item, *each in bounds),
            *((term.name, term.margin, term.low, term.high) for term in self.terms),
        ):
            _check_margins(name, margins, low, high, self.horizon)
        if len(self.state_margins) not in (0, len(system.states)):
            raise UserError(f"mpc: state_margins has {len(self.state_margins)} rows for {len(system.states)} states")
        return sized

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
                there = known(name, names) if names else "the problem has none"
                raise UserError(f"mpc: there is no stage parameter {name}: {there}")
        for name, sound in _stage_parameters(values, self.horizon):
            stage[:, names.index(name)] = sound

    @property
    def moves(self) -> NDArray[np.int64]:
        """Number of the block of each period, (N,), through which inputs are held."""
        lengths = self.blocks or self.intervals or (1,) * self.horizon
        numbers = np.repeat(np.arange(len(lengths)), lengths)
        return np.pad(numbers, (0, self.horizon - len(numbers)), mode="edge")

    @property
    def weights(self) -> StageWeights:
        """Weights of the horizon's stages, for a problem that is :meth:`sized`."""
        return self._weights(self.horizon)

    @property
    def stage_weights(self) -> StageWeights:
        """Weights of one stage, for whole loops, for a problem that is :meth:`sized`."""
        return _stage_weights(self)

    def _weights(self, stages: int) -> StageWeights:
        lengths = np.zeros((stages, 1))
        if stages == self.horizon and self.intervals:
            lengths[np.cumsum(self.intervals) - 1, 0] = self.intervals
        else:
            lengths[:] = 1.0
        counts = lengths > 0.0
        outputs = lengths * (np.array(self.output_weights) / np.array(self.output_scales) ** 2)
        if self.final_output_weights and stages == self.horizon:
            outputs[-1] = np.array(self.final_output_weights) / np.array(self.output_scales) ** 2
        terms, none = self.terms, np.zeros(outputs.shape)
        margins = np.array(self.state_margins).T.copy() if self.state_margins and stages == self.horizon else 0.0
        return StageWeights(
            outputs=np.hstack([outputs, *(self._staged(term, term.weight, 0.0, lengths) for term in terms)]),
            prices=np.hstack([none, *(self._staged(term, term.price, 0.0, lengths) for term in terms)]),
            rates=np.tile(self.rate_weights, (stages, 1)),
            inputs=np.tile(self.input_weights, (stages, 1)),
            rest=np.array(self.input_rest),
            low=np.where(counts, np.array(self.state_low) + margins, -math.inf),
            high=np.where(counts, np.array(self.state_high) - margins, math.inf),
            linear=np.array(self.soft_linear),
            quadratic=np.array(self.soft_quadratic),
            value_low=np.hstack(
                [none - math.inf, *(self._staged(term, term.low, -math.inf, counts, 1.0) for term in terms)]
            ),
            value_high=np.hstack(
                [none + math.inf, *(self._staged(term, term.high, math.inf, counts, -1.0) for term in terms)]
            ),
            value_linear=np.concatenate([none[0], [term.soft_linear for term in terms]]),
            value_quadratic=np.concatenate([none[0], [term.soft_quadratic for term in terms]]),
        )

    def _staged(
        self, term: StageTerm, values: Numbers | float, without: float, counts: NDArray[Any], moved: float = 0.0
    ) -> Array:
        """A column (stages, 1) of a term's values; ``without`` where it does not count. counts (stages, 1): their
        factors, or whether bounds hold. moved: factor of the margin that is added to them.
        """
        found = np.broadcast_to(np.array(values, dtype=float), (self.horizon,))[: len(counts), None].copy()
        if len(counts) == self.horizon:
            found += moved * np.broadcast_to(term.margin, (self.horizon,))[:, None]
        if term.final:
            found[: -1 if len(counts) == self.horizon else None] = without
        elif counts.dtype != np.bool_:
            found *= counts
        elif not term.hard:
            found[~counts] = without
        return found


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


def _lengths(name: str, given: Any, horizon: int) -> tuple[int, ...]:
    """Lengths of intervals or blocks. Raises UserError for what is no list of whole numbers from 1 on, or does not fit
    the horizon.
    """
    found = tuple(given) if isinstance(given, list | tuple) else (given,)
    for item in found:
        if not isinstance(item, int) or isinstance(item, bool) or item < 1:
            raise UserError(f"mpc: {name} has {item!r}; give whole numbers of periods from 1 on, such as [1, 1, 2, 4]")
    if sum(found) > horizon or (found and name == "intervals" and sum(found) < horizon):
        most = "at most" if name == "blocks" else "exactly"
        raise UserError(f"mpc: {name} have {sum(found)} periods together; they need {most} the horizon's {horizon}")
    return found


def _check_margins(name: str, margins: Numbers | float, low: float, high: float, horizon: int) -> None:
    """Raise UserError for margins that are none, and for those that leave nothing between two bounds."""
    values = np.atleast_1d(margins)
    if len(values) not in (1, horizon):
        raise UserError(f"mpc: {name} has {len(values)} margins; it needs one, or {horizon}, one for each stage")
    for stage, margin in enumerate(values.tolist(), start=1):
        if not 0.0 <= margin < math.inf:
            raise UserError(
                f"mpc: {name} has a margin of {margin:g} at stage {stage}; it must be at least 0, and finite"
            )
        if not low + margin < high - margin:
            raise UserError(
                f"mpc: tightening leaves nothing of {name} at stage {stage}: its bounds {low:g} and {high:g} move in "
                f"by {margin:.3g} each; widen them, or ask a smaller share"
            )
