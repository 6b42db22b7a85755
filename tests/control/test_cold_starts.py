"""A cold start of the exact MPC: the states are variables at first, as the dynamics bend."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.mpc_gallery import mechanics
from hybrid_sysid_ros.control import ExactMpc, Status

TOLERANCE = 1e-6
"""Share of the cost."""


@pytest.fixture(scope="module")
def swing_up():
    return mechanics.swing_up()


@pytest.fixture(scope="module")
def solved(swing_up):
    exact = ExactMpc(swing_up.system, swing_up.problem)
    return exact, exact.control(*swing_up.instance), exact.iterations


def test_a_pole_is_raised_in_as_many_steps_as_by_multiple_shooting(swing_up, solved):
    """acados takes 13 by Gauss-Newton; steps whose inputs are simulated end in an optimum that costs twice as much,
    or take 35.
    """
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    exact, plan, steps = solved
    peer = found.InteriorPointMpc(swing_up.system, swing_up.problem, tolerance=1e-10)
    cost, best = (exact.follow(inputs)[0] for inputs in (plan.inputs, peer.control(*swing_up.instance).inputs))
    assert plan.status is Status.SOLVED
    assert cost == pytest.approx(best, rel=TOLERANCE)
    assert steps <= 13


def test_its_planned_states_have_no_gaps(swing_up, solved):
    exact, plan, _ = solved
    np.testing.assert_allclose(plan.states, exact.follow(plan.inputs)[1][1:], atol=1e-9)


def test_neither_a_clock_nor_a_batch_leads_elsewhere(swing_up, solved):
    exact, plan, steps = solved
    looked = ExactMpc(swing_up.system, swing_up.problem, clock=lambda: 0.0)
    np.testing.assert_allclose(looked.control(*swing_up.instance).inputs, plan.inputs, atol=1e-9)
    assert looked.iterations == steps
    row = np.concatenate([np.ravel(part) for part in swing_up.instance])
    answers = exact.solve_many(np.array([row, row]), threads=2)
    for inputs in answers.inputs:
        np.testing.assert_array_equal(inputs, plan.inputs)


@pytest.mark.parametrize("make", [mechanics.masses, mechanics.masses_uneven])
def test_linear_dynamics_take_one_step(make):
    case = make()
    exact = ExactMpc(case.system, case.problem)
    assert exact.control(*case.instance).status is Status.SOLVED
    assert exact.iterations == 1


def test_no_more_steps_are_made_than_are_allowed(swing_up):
    for most in (1, 3):
        hasty = ExactMpc(swing_up.system, replace(swing_up.problem, max_iterations=most))
        assert hasty.control(*swing_up.instance).status is Status.NOT_CONVERGED
        assert hasty.iterations == most


@pytest.mark.parametrize("most", [2, 3, 5])
def test_a_plan_costs_no_more_than_the_inputs_that_it_began_with(most):
    """Here steps that leave gaps agree with their linear prediction where the inputs cost 30 times as much."""
    case = mechanics.moving_obstacle()
    _, disturbance, previous, preview = case.instance
    hasty = ExactMpc(case.system, replace(case.problem, max_iterations=most))
    plan = hasty.control(np.array([1.6, 1.4, 1.2, 0.2, -0.1]), disturbance, previous, preview)
    assert plan.status is Status.NOT_CONVERGED
    assert hasty.follow(plan.inputs)[0] <= hasty.follow(np.tile(previous, (hasty.horizon, 1)))[0]
