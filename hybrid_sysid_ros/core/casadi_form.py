"""The CasADi form, for IPOPT and code generation. Who needs it imports this file by name: nothing else loads CasADi."""

from __future__ import annotations

import casadi

from hybrid_sysid_ros.core import perceptron
from hybrid_sysid_ros.core.equation import Equation
from hybrid_sysid_ros.core.operations import Operations


def symbolic(smoothing: float = 0.0) -> Operations:
    """CasADi's operations. The corners of ``saturate`` are rounded over ``smoothing`` (in the units of its argument).

    saturate(x, L) = (sqrt((x + L)^2 + s^2) - sqrt((x - L)^2 + s^2)) / 2, which tends to the exact one as s -> 0.
    """

    def saturate(x: casadi.SX, limit: casadi.SX) -> casadi.SX:
        if smoothing == 0.0:
            return casadi.fmax(casadi.fmin(x, limit), -limit)
        return (casadi.sqrt((x + limit) ** 2 + smoothing**2) - casadi.sqrt((x - limit) ** 2 + smoothing**2)) / 2

    return Operations(
        function=lambda part: part,
        exp=casadi.exp,
        tanh=casadi.tanh,
        sqrt=casadi.sqrt,
        absolute=casadi.fabs,
        minimum=casadi.fmin,
        maximum=casadi.fmax,
        select=casadi.if_else,
        saturate=saturate,
        perceptron=lambda network: perceptron.unrolled(network, casadi.tanh),
    )


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
