"""Directions of the state that nothing depends on: a shaft that has turned once moves as it did before."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.steady_motion import jacobian_at
from hybrid_sysid_ros.support.arrays import Array

SIZES = 0.0, 0.01, 0.1, 1.0, 10.0
"""Of the states at which is looked [their units]."""
POINTS = 8
"""Of each size."""
IDLE = 1e-10
"""Of a singular value, in the largest one: below it there is none."""


def without_idle(system: System, problem: ControlProblem) -> Array:
    """The map (n, n), lower triangular, that takes from a state what neither its own motion nor the cost depends on.

    Directions v with (A - I) v = 0 of each step's derivatives A, C v = 0 of the tracked outputs', and no bounded state
    in v. Of each v one state becomes 0 and takes the others along, so that of two angles their difference is left.
    """
    random, n = np.random.default_rng(0), len(system.states)
    tracked = [k for k, weight in enumerate(problem.output_weights) if weight > 0]
    bounded = np.isfinite(problem.state_low) | np.isfinite(problem.state_high)
    rows = [np.eye(n)[bounded]]
    for size in np.repeat(SIZES, POINTS):
        x, u = size * random.normal(size=n), random.uniform(problem.input_low, problem.input_high)
        rows.append(jacobian_at(system, problem, x, u, output=False)[1] - np.eye(n))
        rows.append(jacobian_at(system, problem, x, u, output=True)[1][tracked])
    stacked = np.nan_to_num(np.concatenate(rows), posinf=0.0, neginf=0.0)
    _, values, directions = np.linalg.svd(stacked)
    found, kept = directions[values <= IDLE * values[0]], np.eye(n)
    for place in range(n):
        # Echelon form: the first state of a direction is taken as 0, and out of the other directions.
        with_it = np.flatnonzero(np.abs(found[:, place]) > 1e-6)
        if len(with_it):
            direction = found[with_it[0]] / found[with_it[0], place]
            found = np.delete(found - np.outer(found[:, place], direction), with_it[0], axis=0)
            change = np.eye(n)
            change[:, place] -= direction
            kept = change @ kept
    return np.where(np.abs(kept) > 1e-9, kept, 0.0)
