"""The cheapest rest: where outputs stay, of all steady motions that more inputs than tracked outputs leave."""

from __future__ import annotations

import daqp
import numpy as np
import scipy

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.terms import FAR
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.steady_motion import (
    NEWTON_STEPS,
    STEADY,
    SteadyMotion,
    jacobian_at,
    steady_motion,
)
from hybrid_sysid_ros.support.arrays import Array

SMALL = 1e-9
"""Weight of what costs nothing, in that of the dearest input."""


def cheapest_rest(system: System, problem: ControlProblem, outputs: Array) -> SteadyMotion:
    """The steady motion at outputs (p,), within the bounds of states and inputs, whose inputs cost least by sum R u^2;
    :func:`steady_motion` where the outputs leave no choice, or nothing is within the bounds. The problem is sized.

    Newton's method on the equations of the motion, whose linear solutions are left to a quadratic program.
    """
    found, n = steady_motion(system, problem, outputs), len(system.states)
    tracked = np.flatnonzero(np.array(problem.output_weights) > 0.0)
    if len(system.inputs) <= len(tracked):
        return found
    z = np.concatenate([found.state, found.inputs])
    drift = jacobian_at(system, problem, z[:n], z[n:], output=False)[0] - z[:n]
    costs = np.array(problem.input_weights) if any(problem.input_weights) else np.ones(len(system.inputs))
    weights = np.maximum([*np.zeros(n), *costs], SMALL * costs.max())
    for _ in range(NEWTON_STEPS):
        following, by_x, by_u = jacobian_at(system, problem, z[:n], z[n:], output=False)
        y, *by_z = jacobian_at(system, problem, z[:n], z[n:], output=True)
        equations = np.vstack([np.hstack([by_x - np.eye(n), by_u]), np.hstack(by_z)[tracked]])
        residual = np.concatenate([following - z[:n] - drift, (y - outputs)[tracked]])
        nearest = z - np.linalg.lstsq(equations, residual, rcond=None)[0]
        at = _cheapest(problem, nearest, scipy.linalg.null_space(equations), weights)
        if at is None:
            return found
        change, z = np.max(np.abs(at - z)), at
        if change <= STEADY * (1.0 + np.max(np.abs(z))):
            break
    return SteadyMotion(z[:n], z[n:], by_z[0][tracked])


def _cheapest(problem: ControlProblem, at: Array, free: Array, weights: Array) -> Array | None:
    """The cheapest [x, u] = at + free t within the bounds; None where there is none."""
    low, high = np.array([*problem.state_low, *problem.input_low]), np.array([*problem.state_high, *problem.input_high])
    sides = (np.clip(side - at, -FAR, FAR) for side in (high, low))
    t, _, flag, _ = daqp.solve(free.T @ (weights[:, None] * free), free.T @ (weights * at), free, *sides)
    return at + free @ t if flag > 0 and np.isfinite(t).all() else None
