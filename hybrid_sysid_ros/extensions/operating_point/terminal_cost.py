"""Riccati's terminal cost: what the rest of time costs about a point of rest, by the linear system there."""

from __future__ import annotations

import numpy as np
import scipy

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.terms import StageTerm
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.operating_point.cheapest_rest import cheapest_rest
from hybrid_sysid_ros.extensions.shared.steady_motion import jacobian_at
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

STILL = 1e-6
"""Largest change of a state at rest in a step."""

LEAST = 1e-9
"""Smallest share of the largest eigenvalue that makes a term, and of the largest weight that changes of inputs have."""


def riccati_terms(system: System, problem: ControlProblem, outputs: Array) -> tuple[StageTerm, ...]:
    """Terms at the end of the horizon that add the cost of all later stages, for small deviations from rest at outputs
    (p,), without bounds: V = z'P z of z = [states, inputs] - [their values at rest], as sums of squares.

    Bertsekas (2017), Dynamic programming and optimal control I, section 3.1. Raises UserError where there is no rest at
    these outputs, where no feedback comes to rest there, or the weights don't see the states.
    """
    problem = problem.sized(system)
    if outputs.shape != (len(system.outputs),):
        raise UserError(f"mpc: riccati_at has shape {outputs.shape}; give {len(system.outputs)} outputs in SI units")
    rest = cheapest_rest(system, problem, outputs)
    weights, (n, m) = problem.stage_weights, (len(system.states), len(system.inputs))
    a, b = np.eye(n), np.zeros((n, m))
    following, by_x, by_u = jacobian_at(system, problem, rest.state, rest.inputs, output=False)
    if not np.allclose(following, rest.state, rtol=STILL, atol=STILL):
        raise UserError(f"mpc: {type(system).__name__} is not at rest at outputs {outputs.tolist()}; give others")
    for _ in range(problem.substeps):
        a, b = by_x @ a, by_x @ b + by_u
    _, c, d = jacobian_at(system, problem, rest.state, rest.inputs, output=True)
    whole = np.block([[a, b], [np.zeros((m, n)), np.eye(m)]]), np.vstack([b, np.eye(m)])
    # The input is a state, and its change the input, because changes have weights. y is that at an interval's end.
    end = np.hstack([c, d])
    seen = end.T @ (weights.outputs[0, : len(outputs), None] * end)
    seen[n:, n:] += np.diag(weights.inputs[0])
    on_changes = np.maximum(weights.rates[0], LEAST * max(np.abs(seen).max(), 1.0))
    # A stage costs what its end does: seen along the new state.
    forward, into = whole
    try:
        found = scipy.linalg.solve_discrete_are(
            forward,
            into,
            forward.T @ seen @ forward,
            np.diag(on_changes) + into.T @ seen @ into,
            s=forward.T @ seen @ into,
        )
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UserError(f"mpc: there is no Riccati cost at {outputs.tolist()}: {error}") from error
    values, vectors = np.linalg.eigh(0.5 * (found + found.T))
    names = [item.name for item in (*system.states, *system.inputs)]
    at = [*rest.state, *rest.inputs]
    terms = []
    for number in np.flatnonzero(values > LEAST * values.max()):
        parts = zip(vectors[:, number], names, at, strict=True)
        formula = " + ".join(f"({float(part)!r}) * ({name} - ({float(place)!r}))" for part, name, place in parts)
        terms.append(StageTerm(name=f"riccati_{number}", value=formula, weight=float(values[number]), final=True))
    return tuple(terms)
