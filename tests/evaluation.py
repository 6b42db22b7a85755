"""The CasADi form of systems, for tests."""

import casadi

from hybrid_sysid_ros.core import trace


def parametric_step(system, *, step, smoothing=0.0):
    """The CasADi form of a step as an expression of symbols x, u and p: (x, u, p, following)."""
    weights = casadi.SX(casadi.DM(system.weights))
    traced = trace.step_of(system, smooth=smoothing > 0.0, weights=weights)
    following = casadi.substitute([traced.result], [traced.h, traced.s], [casadi.SX(step), casadi.SX(smoothing)])[0]
    return traced.x, traced.u, traced.p, following
