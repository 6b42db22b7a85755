"""The exact MPC of two inputs and two outputs: least squares where it is linear, IPOPT where it is not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.mpc.horizon import new_instance
from hybrid_sysid_ros.control.mpc.shooting import rollout, shooting
from hybrid_sysid_ros.core import simulate
from tests.control.two_inputs import PROBLEM, Arms, Carts, instance

CARTS, ARMS = Carts(), Arms()


def interior_point_mpc(*given, **settings):
    """IPOPT on a problem; without its extension the test is skipped."""
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    return found.InteriorPointMpc(*given, **settings)


def run(system, problem, state, inputs):
    """States (N, n) at the ends of the intervals."""
    step = problem.period / problem.substeps
    return simulate(system, state, inputs.repeat(problem.substeps, axis=0), step=step, every=problem.substeps)[1:]


def least_squares_form(problem, state, disturbance, previous, preview):
    """|| M U - v ||^2 is the cost on the carts; the columns of M are responses, for the system is linear."""
    count = 2 * problem.horizon
    free = run(CARTS, problem, state, np.tile(disturbance, (problem.horizon, 1)))[:, :2]
    responses = [run(CARTS, problem, np.zeros(4), np.eye(count)[k].reshape(-1, 2))[:, :2].ravel() for k in range(count)]
    root = np.tile(np.sqrt(problem.output_weights) / problem.output_scales, problem.horizon)
    rate, size = (np.tile(np.sqrt(part), problem.horizon) for part in (problem.rate_weights, problem.input_weights))
    difference = np.eye(count) - np.eye(count, k=-2)
    matrix = np.vstack([root[:, None] * np.array(responses).T, rate[:, None] * difference, np.diag(size)])
    before = np.zeros(count)
    before[:2] = previous
    return matrix, np.concatenate([root * (preview - free).ravel(), rate * before, np.zeros(count)])


@pytest.fixture(scope="module")
def carts_mpc():
    return ExactMpc(CARTS, PROBLEM, tolerance=1e-9)


def test_on_a_linear_system_it_is_the_bounded_least_squares_solution(carts_mpc):
    active = []
    for seed in range(20):
        asked = instance(seed)
        matrix, right = least_squares_form(PROBLEM, *asked)
        low, high = np.tile(PROBLEM.input_low, 12), np.tile(PROBLEM.input_high, 12)
        previous = np.clip(asked[2], PROBLEM.input_low, PROBLEM.input_high)
        matrix, right = least_squares_form(PROBLEM, asked[0], asked[1], previous, asked[3])
        expected = lsq_linear(matrix, right, bounds=(low, high), tol=1e-13, method="bvls").x.reshape(-1, 2)
        plan = carts_mpc.control(*asked)
        assert plan.status is Status.SOLVED
        np.testing.assert_allclose(plan.inputs, expected, atol=1e-6)
        np.testing.assert_array_equal(plan.input, plan.inputs[0])
        at_low, at_high = np.isclose(expected, PROBLEM.input_low), np.isclose(expected, PROBLEM.input_high)
        active.append([at_low[:, 0].any(), at_low[:, 1].any(), at_high[:, 0].any(), at_high[:, 1].any()])
    assert np.all(np.sum(active, axis=0) > 0)  # each of the four bounds, which are not symmetric


OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "one output tracked": {"output_weights": (50.0, 0.0)},
    "rate limit of one input": {"rate_limits": (0.3, np.inf)},
    "rate limits": {"rate_limits": (0.3, 0.2)},
    "soft bounds": {
        "state_low": (-np.inf, -0.1, -1.0, -np.inf),
        "state_high": (np.inf, 0.2, np.inf, 1.0),
        "soft_quadratic": (1.0, 300.0, 20.0, 30.0),
        "soft_linear": (0.0, 5.0, 0.0, 0.0),
    },
}


def cost(problem, plan, previous, preview, disturbance):
    outputs = np.array(
        [np.ravel(ARMS.output(x, u + disturbance)) for x, u in zip(plan.states, plan.inputs, strict=True)], dtype=float
    )
    errors = (outputs - preview) / problem.output_scales
    changes = np.diff(plan.inputs, axis=0, prepend=previous[None])
    outside = np.maximum(np.maximum(plan.states - problem.state_high, problem.state_low - plan.states), 0.0)
    return (
        np.sum(errors**2 @ problem.output_weights)
        + np.sum(changes**2 @ problem.rate_weights)
        + np.sum(plan.inputs**2 @ problem.input_weights)
        + np.sum(outside @ problem.soft_linear)
        + np.sum(outside**2 @ problem.soft_quadratic)
    )


@pytest.mark.parametrize("option", OPTIONS)
def test_on_arms_with_friction_it_finds_what_an_interior_point_solver_finds(option):
    problem = replace(PROBLEM, **OPTIONS[option]).sized(ARMS)
    exact = ExactMpc(ARMS, problem, tolerance=1e-8)
    peer = interior_point_mpc(ARMS, replace(problem, max_iterations=500), tolerance=1e-10)
    ratios, bound = [], False
    for seed in range(8):
        exact.reset()
        peer.reset()
        state, disturbance, previous, preview = instance(seed)
        previous = np.clip(previous, problem.input_low, problem.input_high)
        plan, expected = (each.control(state, disturbance, previous, preview) for each in (exact, peer))
        assert plan.status is Status.SOLVED
        costs = [cost(problem, each, previous, preview, disturbance) for each in (plan, expected)]
        ratios.append(costs[0] / costs[1])
        if abs(ratios[-1] - 1.0) < 1e-7:
            np.testing.assert_allclose(plan.inputs, expected.inputs, atol=1e-4)
        bound |= bool(np.any(plan.inputs == problem.input_low) or np.any(plan.inputs == problem.input_high))
        changes = np.abs(np.diff(plan.inputs, axis=0, prepend=previous[None]))
        assert np.all(changes <= np.array(problem.rate_limits) + 1e-8)
    assert max(ratios) < 1.02  # friction and nonlinear outputs have several optima
    assert np.mean(np.abs(np.array(ratios) - 1.0) < 1e-6) >= 0.6
    assert bound or option != "plain"


def test_the_cost_of_a_rollout_is_that_of_the_plan_by_hand():
    memory, problem = shooting(ARMS, PROBLEM), PROBLEM.sized(ARMS)
    flat, view = new_instance(ARMS, problem)
    state, disturbance, previous, preview = instance(3)
    flat[:] = np.concatenate([state, disturbance, previous, preview.ravel()])
    inputs = np.random.default_rng(0).normal(size=(12, 2))
    states = np.empty((13, 4))
    found, outside = rollout(memory.prediction, memory.horizon.weights, view, inputs, states)
    np.testing.assert_allclose(states[1:], run(ARMS, problem, state, inputs + disturbance), atol=1e-12)

    class Reported:
        pass

    plan: Any = Reported()
    plan.inputs, plan.states = inputs, states[1:]
    assert found == pytest.approx(cost(problem, plan, previous, preview, disturbance))
    assert outside == 0.0


def test_one_iteration_a_call_follows_the_converged_loop():
    costs = []
    for real_time in (False, True):
        controller, x, u, total = ExactMpc(ARMS, PROBLEM, real_time=real_time), np.zeros(4), np.zeros(2), 0.0
        for k in range(80):
            ahead = PROBLEM.period * (k + np.arange(1, 13))
            preview = np.column_stack([0.3 * np.sin(2.0 * ahead), 0.2 * np.sign(np.sin(1.5 * ahead))])
            u = controller.control(x, np.zeros(2), u, preview).input
            controller.prepare(PROBLEM.period)
            x = run(ARMS, PROBLEM, x, u[None])[-1]
            total += 200.0 * (np.sin(x[1]) - preview[0, 0]) ** 2
        costs.append(total)
    assert costs[1] == pytest.approx(costs[0], rel=0.05)


@pytest.mark.parametrize("value", [1e12, 1e300, np.inf, np.nan])
@pytest.mark.parametrize("place", range(4))
def test_inputs_keep_their_bounds_whatever_is_asked(place, value):
    problem = replace(PROBLEM, rate_limits=(0.5, np.inf))
    controller = ExactMpc(ARMS, problem)
    for started in (False, True):
        asked = list(instance(1))
        if started:
            controller.control(*instance(2))
        asked[place] = np.full_like(asked[place], value)
        inputs = controller.control(*asked).inputs
        assert np.all((inputs >= problem.input_low) & (inputs <= problem.input_high))
        assert np.all(np.abs(np.diff(inputs[:, 0])) <= 0.5 + 1e-9)
        assert controller.control(*instance(3)).status is Status.SOLVED
