"""A trace: a law as CasADi expressions of its states, inputs, parameters and blocks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import casadi
import numpy as np

from hybrid_sysid_ros.core.blocks import BlockCall, Calls, tracing
from hybrid_sysid_ros.core.mathematics import Scalar, rounded, rows
from hybrid_sysid_ros.core.steppers import StepContext, Stepper
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


class Traceable(Protocol):
    """The parts of a system that a trace reads."""

    @property
    def states(self) -> Sequence[Any]: ...
    @property
    def inputs(self) -> Sequence[Any]: ...
    @property
    def outputs(self) -> Sequence[Any]: ...
    @property
    def declared_states(self) -> Sequence[Any]: ...
    @property
    def parameters(self) -> Sequence[Any]: ...
    @property
    def values(self) -> Array: ...
    @property
    def form(self) -> tuple[Any, ...]: ...
    @property
    def stepper(self) -> Stepper: ...
    def bound(self, values: Sequence[Scalar]) -> Traceable: ...
    def step_context(self) -> StepContext: ...
    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """Expressions ``result`` (rows,) of the symbols x (states,), u (inputs,), p (parameters,), the step h (1,), the
    smoothing s (1,), and of the calls of blocks, in the order in which they must be made.
    """

    x: casadi.SX
    u: casadi.SX
    p: casadi.SX
    h: casadi.SX
    s: casadi.SX
    result: casadi.SX
    calls: Sequence[BlockCall]


def step_of(system: Traceable, *, smooth: bool = False, weights: casadi.SX | None = None) -> Trace:
    """The trace of one step. smooth: stick-slip is rounded over s. weights: see :class:`~.blocks.Calls`."""
    kinematics = kinematics_of(system)

    def advance(bound: Traceable, x: list[Scalar], u: list[Scalar], h: Scalar, s: Scalar) -> Sequence[Scalar]:
        context = replace(bound.step_context(), kinematics=kinematics)
        with rounded(smooth):
            return bound.stepper.advance(context, x, u, h, s if smooth else None)

    return _traced(system, "the step", advance, weights)


def law_of(system: Traceable, *, smooth: bool = False, weights: casadi.SX | None = None) -> Trace:
    """The trace of the rates, for steppers that call the law several times. smooth: corners that have a width are
    rounded. weights: see :class:`~.blocks.Calls`.
    """
    count = len(system.declared_states)

    def law(bound: Traceable, x: list[Scalar], u: list[Scalar], h: Scalar, s: Scalar) -> Sequence[Scalar]:
        with rounded(smooth):
            return bound.step_context().rates(x[:count], u)

    return _traced(system, "law(x, u)", law, weights)


def output_of(system: Traceable, *, weights: casadi.SX | None = None) -> Trace:
    """The trace of the output map."""

    def output(bound: Traceable, x: list[Scalar], u: list[Scalar], h: Scalar, s: Scalar) -> Sequence[Scalar]:
        return rows(bound.output(x, u), len(system.outputs), f"{type(system).__name__}: output(x, u)", "outputs")

    return _traced(system, "output(x, u)", output, weights)


def shown_states(system: Traceable) -> tuple[int, ...]:
    """For each output the index of the state that it is; -1: it is computed."""
    traced = output_of(system)
    states = casadi.vertsplit(traced.x)
    return tuple(
        next((i for i, state in enumerate(states) if casadi.is_equal(output, state)), -1)
        for output in casadi.vertsplit(traced.result)
    )


def kinematics_of(system: Traceable) -> Mapping[int, int]:
    """Position state -> the velocity state that is its rate in the law."""
    key = system.form
    if key not in _KINEMATICS:
        traced = law_of(system)
        states = casadi.vertsplit(traced.x)
        _KINEMATICS[key] = {
            i: j
            for i, rate in enumerate(casadi.vertsplit(traced.result))
            for j, state in enumerate(states)
            if i != j and casadi.is_equal(rate, state) and not system.stepper.is_map
        }
    return _KINEMATICS[key]


_KINEMATICS: dict[Any, Mapping[int, int]] = {}

Traced = Callable[[Traceable, list[Scalar], list[Scalar], Scalar, Scalar], Sequence[Scalar]]
"""(system whose parameters are symbols, x, u, h, s) -> the values to trace."""


def _traced(system: Traceable, what: str, function: Traced, weights: casadi.SX | None) -> Trace:
    """The trace of a function. Raises UserError where it can't be traced, or is not finite at the origin."""
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    p, h, s = casadi.SX.sym("p", len(system.parameters)), casadi.SX.sym("h"), casadi.SX.sym("s")
    kind = type(system).__name__
    try:
        with tracing(Calls(weights=weights)) as calls, warnings.catch_warnings():
            warnings.filterwarnings("error", r"\s*casadi: a numpy function", FutureWarning)
            result = casadi.vertcat(*function(system.bound(_split(p)), _split(x), _split(u), h, s))
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # a user's law can raise anything
        raise UserError(f"{kind}: {what} can't be traced: {_cause(error)}") from error
    traced = Trace(x=x, u=u, p=p, h=h, s=s, result=casadi.SX(result), calls=tuple(calls.made))
    values = system.values
    if np.all(np.isfinite(values)):  # else a parameter is wrong, which is reported elsewhere
        symbols = [x, u, p, h, s, *(call.outputs for call in calls.made)]
        origin = casadi.Function("origin", symbols, [traced.result])
        found = np.array(origin(0.0, 0.0, values, TRIAL_STEP, 0.0, *([0.0] * len(calls.made)))).ravel()
        if not np.all(np.isfinite(found)):
            names = [item.name for item in (system.outputs if what.startswith("output") else system.states)]
            raise NotFiniteError(kind, what, names[int(np.argmin(np.isfinite(found)))])
    return traced


class NotFiniteError(UserError):
    """A function of a system that is not finite at the origin."""

    def __init__(self, kind: str, what: str, name: str) -> None:
        """kind: class of the system. what: the function. name: of the state or output."""
        super().__init__(
            f"{kind}: {what} is not finite for {name} where states and inputs are zero; keep divisors from zero with "
            "maximum or select, and use core.mathematics in place of math"
        )
        self.name = name


TRIAL_STEP = 1e-3
"""Length of a trial step [s]."""


def _split(column: casadi.SX) -> list[Scalar]:
    return list(casadi.vertsplit(column)) if column.numel() else []


def _cause(error: BaseException) -> str:
    text = " ".join(str(error).split())
    if "truth value" in text or "scalar nodes" in text.lower() or "__bool__" in text:
        return "Python's if, and, min and max can't look at a state; use select, minimum and maximum"
    if isinstance(error, FutureWarning):
        return "numpy's functions can't take a state or an input; use those of core.mathematics"
    return f"{type(error).__name__}: {text[:200]}"
