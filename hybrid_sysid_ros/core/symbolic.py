"""A system as CasADi functions, for IPOPT, do-mpc, acados and scripts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np

from hybrid_sysid_ros.core import trace
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.trace import Trace
from hybrid_sysid_ros.support.arrays import Array


def symbolic_step(system: System, *, step: float, substeps: int = 1, smoothing: float = 0.0) -> casadi.Function:
    """The step as a CasADi function (x, u) -> following over ``substeps`` steps of ``step`` [s] with u held.

    The input delays are not part of it: u is the input that acts now. smoothing: rounds the corners of stick-slip, in
    the unit of the velocity; 0 gives the compiled form exactly.
    """
    traced = trace.step_of(system, smooth=smoothing > 0.0, weights=casadi.SX(casadi.DM(system.weights)))
    one = _function("one", traced, "following")
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    state = x
    for _ in range(substeps):
        state = one(state, u, casadi.DM(system.values), step, smoothing)
    return casadi.Function("step", [x, u], [state], ["x", "u"], ["following"])


def symbolic_output(system: System) -> casadi.Function:
    """The output map as a CasADi function (x, u) -> y."""
    traced = trace.output_of(system, weights=casadi.SX(casadi.DM(system.weights)))
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    y = _function("output", traced, "y")(x, u, casadi.DM(system.values), 0.0, 0.0)
    return casadi.Function("output", [x, u], [y], ["x", "u"], ["y"])


def equations_in_c(system: System, name: str, *, step: float) -> str:
    """C of NAME_following and NAME_output, the step of ``step`` [s] and the output map, functions of states, inputs and
    parameters that CasADi prints.
    """
    weights = casadi.SX(casadi.DM(system.weights))
    generator = casadi.CodeGenerator(f"{name}_equations.c", {"with_header": False, "casadi_int": "int"})
    for what, found in (
        ("following", trace.step_of(system, weights=weights)), ("output", trace.output_of(system, weights=weights)),
    ):  # fmt: skip
        (result,) = casadi.substitute([found.result], [found.h, found.s], [casadi.SX(step), casadi.SX(0.0)])
        generator.add(casadi.Function(f"{name}_{what}", [found.x, found.u, found.p], [casadi.densify(result)]))
    head = "#define CASADI_SYMBOL_EXPORT /* nothing: no other library calls these */\n"
    return f"/* The equations, printed by CasADi. Generated; do not edit. */\n{head}\n{generator.dump()}"


def symbolic_features(system: System) -> casadi.Function:
    """The features of a network as a CasADi function of the declared states and the inputs, (x, u) -> z."""
    return _of_declared(system, "z", system.feature)


def symbolic_closures(system: System) -> casadi.Function:
    """The closures, which a hybrid may correct, as a CasADi function of declared states and inputs, (x, u) -> c."""
    return _of_declared(system, "c", system.closure)


def _of_declared(system: System, name: str, values: Callable[[Sequence[Any], Sequence[Any]], Any]) -> casadi.Function:
    x, u = casadi.SX.sym("x", len(system.declared_states)), casadi.SX.sym("u", len(system.inputs))
    found = casadi.vertcat(*values(casadi.vertsplit(x), casadi.vertsplit(u)))
    return casadi.Function("values", [x, u], [casadi.SX(found)], ["x", "u"], [name])


def symbolic_values(system: System, values: Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]) -> casadi.Function:
    """A function of all states and inputs as a CasADi function (x, u) -> values."""
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    found = casadi.vertcat(*values(casadi.vertsplit(x), casadi.vertsplit(u)))
    return casadi.Function("values", [x, u], [found], ["x", "u"], ["values"])


def symbolic_rates(system: System) -> casadi.Function:
    """The law as a CasADi function (x, u) -> (rates, jacobian): rates of the declared states without the contacts'
    friction, and their Jacobian (states, states + inputs). For a map from sample to sample they are its next states.
    """
    traced = trace.law_of(system, weights=casadi.SX(casadi.DM(system.weights)))
    given = casadi.vertcat(traced.x, traced.u)
    parts = [traced.result, casadi.jacobian(traced.result, given)]
    rates, jacobian = casadi.substitute(parts, [traced.p], [casadi.SX(casadi.DM(system.values))])
    return casadi.Function("rates", [traced.x, traced.u], [rates, jacobian], ["x", "u"], ["rates", "jacobian"])


def linearised(system: System, x: Array, u: Array) -> tuple[Array, Array]:
    """Derivatives of a law's rates (states, states) and (states, inputs) at x (states,) and u (inputs,), with viscous
    friction and without dry friction; they are zero where a law has no derivative.
    """
    n = len(system.declared_states)
    full = np.nan_to_num(np.array(symbolic_rates(system)(x, u)[1]), posinf=0.0, neginf=0.0)
    return full[:, :n] - np.diag(viscous(system, x, u)), full[:, len(system.states) :]


def viscous(system: System, x: Array, u: Array) -> Array:
    """Viscous friction (states,) of the contacts on each declared state at x (states,) and u (inputs,), per unit of
    the state.
    """
    names = [item.name for item in system.declared_states]
    context, found = system.step_context(), np.zeros(len(names))
    for contact in system.contacts:
        found[names.index(contact.on)] += float(context.field(contact.viscous, x.tolist(), u.tolist()))
    return found


def _function(name: str, traced: Trace, result: str) -> casadi.Function:
    given = [traced.x, traced.u, traced.p, traced.h, traced.s]
    return casadi.Function(name, given, [traced.result], ["x", "u", "p", "h", "s"], [result])
