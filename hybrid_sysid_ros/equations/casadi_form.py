"""The CasADi form: for MPC, Jacobians and code generation."""

from __future__ import annotations

import casadi

from hybrid_sysid_ros.equations.equation import Equation
from hybrid_sysid_ros.equations.operations import symbolic


def symbolic_step(equation: Equation, *, step: float, substeps: int = 1, smoothing: float = 0.0) -> casadi.Function:
    """The equation's step as a CasADi function (x, u) -> x+ over ``substeps`` steps of ``step`` [s] with u held.

    The input delay is not part of it: u is the input that acts now. ``smoothing`` (units of the friction state) rounds
    the corners of stick-slip; 0 gives the compiled form exactly.
    """
    advance = equation.advance(symbolic(smoothing))
    x = casadi.SX.sym("x", len(equation.states))
    u = casadi.SX.sym("u", len(equation.inputs))
    weights = [float(value) for value in equation.weights]
    state = casadi.vertsplit(x)
    for _ in range(substeps):
        following: list[casadi.SX] = [casadi.SX(0)] * len(equation.states)
        advance(state, casadi.vertsplit(u), equation.named, weights, step, following)
        state = following
    return casadi.Function("step", [x, u], [casadi.vertcat(*state)], ["x", "u"], ["following"])
