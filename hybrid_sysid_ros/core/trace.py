"""A trace: what a law computes, as CasADi expressions of its states, inputs, parameters and blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi

from hybrid_sysid_ros.core.blocks import Call, Calls, tracing
from hybrid_sysid_ros.core.mathematics import Scalar, rounded
from hybrid_sysid_ros.support.errors import UserError

if TYPE_CHECKING:
    from hybrid_sysid_ros.core.system import System


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """Expressions ``result`` (rows,) of the symbols x (states,), u (inputs,), p (parameters,), h and s (1,), the step
    and the smoothing, and of the blocks' calls, in the order in which they must be made.
    """

    x: casadi.SX
    u: casadi.SX
    p: casadi.SX
    h: casadi.SX
    s: casadi.SX
    result: casadi.SX
    calls: Sequence[Call]


def step_of(system: System, *, smooth: bool = False, weights: casadi.SX | None = None) -> Trace:
    """One step of the system. smooth: stick-slip rounded over s. weights: see :class:`~.blocks.Calls`."""

    def advance(bound: System, x: list[Scalar], u: list[Scalar], h: Scalar, s: Scalar) -> list[Scalar]:
        motion = replace(bound.motion(), kinematics=kinematics_of(system))
        with rounded(smooth):
            return bound.stepper.advance(motion, x, u, h, s if smooth else None)

    return _traced(system, advance, weights)


def law_of(system: System) -> Trace:
    """The rates of the states, for steppers that call the law several times."""
    return _traced(system, lambda bound, x, u, h, s: bound.motion().rates(x[: len(bound.declared_states)], u), None)


def output_of(system: System, *, weights: casadi.SX | None = None) -> Trace:
    """The outputs."""

    def output(bound: System, x: list[Scalar], u: list[Scalar], h: Scalar, s: Scalar) -> list[Scalar]:
        found = list(bound.output(x, u))
        if len(found) != len(system.outputs):
            raise UserError(
                f"{type(system).__name__}: output(x, u) gives {len(found)} values for {len(system.outputs)} outputs"
            )
        return found

    return _traced(system, output, weights)


def kinematics_of(system: System) -> Mapping[int, int]:
    """Position state -> the velocity state that is its rate, as the law says."""
    key = system.form
    if key not in _KINEMATICS:
        traced = law_of(system)
        states = casadi.vertsplit(traced.x)
        _KINEMATICS[key] = {
            i: j
            for i, rate in enumerate(casadi.vertsplit(traced.result))
            for j, state in enumerate(states)
            if i != j and casadi.is_equal(rate, state)
        }
    return _KINEMATICS[key]


_KINEMATICS: dict[Any, Mapping[int, int]] = {}


def _traced(system: System, function: Any, weights: casadi.SX | None) -> Trace:
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    p, h, s = casadi.SX.sym("p", len(system.parameters)), casadi.SX.sym("h"), casadi.SX.sym("s")
    bound = system.bound(casadi.vertsplit(p) if len(system.parameters) else [])
    with tracing(Calls(weights=weights)) as calls:
        result = function(bound, casadi.vertsplit(x), casadi.vertsplit(u), h, s)
    return Trace(x=x, u=u, p=p, h=h, s=s, result=casadi.vertcat(*result), calls=tuple(calls.made))
