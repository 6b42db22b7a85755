"""Bounds that bend: along them the Hessian is held so firmly that it is positive, and no more, which would be rounding.

Steps of a race car on the edge of its track and of its grip were six times too short where each bound was held by its
whole price, 1e12 times the curvature along the bounds; some starts then took more than 300 steps.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.mpc_gallery.mechanics import race_car
from hybrid_sysid_ros.control import ExactMpc, Status


@pytest.fixture(scope="module")
def solver():
    case = race_car()
    return ExactMpc(case.system, case.problem)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3])
def test_the_steps_to_a_solution_on_bent_bounds_do_not_depend_on_rounding(solver, size):
    state, *others = race_car().instance
    solver.reset()
    plan = solver.control(state + size * np.random.default_rng(0).normal(size=len(state)), *others)
    assert plan.status is Status.SOLVED
    assert solver.iterations <= 30
