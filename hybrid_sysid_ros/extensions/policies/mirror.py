"""Mirror images: where a rig's mirrored motion is one of its motions too, every sample of the MPC is two."""

from __future__ import annotations

from itertools import product

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.steady_motion import jacobian_at
from hybrid_sysid_ros.support.arrays import Array

MOST_STATES = 10
"""Of a system that is looked at: there are 2^n ways to mirror n states."""


def mirror_of(system: System, problem: ControlProblem, states: Array, inputs: Array) -> Array | None:
    """Signs s (n,) with which the exact MPC's plan at s x, -d, -u, -q is the negative one of that at x, d, u, q.

    That holds where step(s x, -u) = s step(x, u), tracked outputs change their sign with the state, and inputs and
    states have bounds alike on both sides. A brake, for instance, keeps its sign when everything turns the other way.
    states (points, n), inputs (points, m): where the system is looked at. None where there are no such signs. The
    problem is sized.
    """
    tracked = [k for k, weight in enumerate(problem.output_weights) if weight > 0]
    low, high = np.array(problem.state_low), np.array(problem.state_high)
    lopsided = np.add(problem.input_low, problem.input_high).any() or np.any(problem.input_rest)
    if lopsided or problem.terms or problem.stage_parameters or len(low) > MOST_STATES:
        return None

    def moved(x: Array, u: Array) -> tuple[Array, Array]:
        following, outputs = (jacobian_at(system, problem, x, u, output=output)[0] for output in (False, True))
        return following, outputs[tracked]

    known = [moved(x, u) for x, u in zip(states, inputs, strict=True)]
    for each in product((-1.0, 1.0), repeat=len(low)):
        signs = np.array(each)
        bounded = np.where(signs < 0.0, low == -high, True).all()
        if bounded and all(
            np.allclose(ahead, signs * following, rtol=1e-9, atol=1e-12, equal_nan=True)
            and np.allclose(shown, -outputs, rtol=1e-9, atol=1e-12, equal_nan=True)
            for x, u, (following, outputs) in zip(states, inputs, known, strict=True)
            for ahead, shown in [moved(signs * x, -u)]
        ):
            return signs
    return None
