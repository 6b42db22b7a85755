"""The exact MPC: quadratic programs with known answers, bounds that hold whatever happens, no offset at rest."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.support.errors import UserError
from tests.control.beam_problem import LINEAR, PROBLEM

UNBOUNDED = dataclasses.replace(PROBLEM, input_low=(-1e6,), input_high=(1e6,))


def interior_point_mpc(*given, **settings):
    """IPOPT on a problem; without its extension the test is skipped."""
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    return found.InteriorPointMpc(*given, **settings)


def least_squares_form(problem, state, disturbance, previous, preview):
    """|| M U - v ||^2 is the cost on the linear model, U the inputs: prediction matrices by hand."""
    h, n = problem.period / problem.substeps, problem.horizon
    half = 0.5 * h * LINEAR.damping  # trapezoidal damping
    velocity = np.array([-h * LINEAR.stiffness, 1 - half]) / (1 + half)
    a = np.array([np.array([1.0, 0.0]) + h * velocity, velocity])
    b = h * LINEAR.gain / (1 + half) * np.array([h, 1.0])
    # Substeps with the input held.
    a_period = np.linalg.matrix_power(a, problem.substeps)
    b_period = sum(np.linalg.matrix_power(a, k) @ b for k in range(problem.substeps))
    free, x = np.empty(n), np.array(state)
    for i in range(n):
        x = a_period @ x + b_period * (disturbance - LINEAR.centre)
        free[i] = x[0]
    response = [(np.linalg.matrix_power(a_period, k) @ b_period)[0] for k in range(n)]
    effect = np.array([[response[i - j] if j <= i else 0.0 for j in range(n)] for i in range(n)])
    tracking, rate = np.sqrt(problem.output_weights[0]) / problem.output_scales[0], np.sqrt(problem.rate_weights[0])
    difference = np.eye(n) - np.eye(n, k=-1)
    matrix = np.vstack([tracking * effect, rate * difference])
    return matrix, np.concatenate([tracking * (preview[:, 0] - free), rate * previous * np.eye(n)[0]])


def instance(seed, size=1.0):
    random = np.random.default_rng(seed)
    state = size * np.array([0.05, 0.3]) * random.normal(size=2)
    preview = size * 0.05 * np.cumsum(random.normal(size=(PROBLEM.horizon, 1)), axis=0) / 3
    return state, 0.3 * random.normal(size=1), np.clip(3 * random.normal(size=1), -10, 10), preview


@pytest.fixture(scope="module")
def bounded():
    return ExactMpc(LINEAR, PROBLEM)


@pytest.fixture(scope="module")
def unbounded():
    return ExactMpc(LINEAR, UNBOUNDED)


def test_without_active_bounds_it_is_the_solution_of_the_normal_equations(unbounded):
    for seed in range(20):
        state, d, previous, preview = instance(seed)
        matrix, right = least_squares_form(UNBOUNDED, state, d[0], previous[0], preview)
        plan = unbounded.control(state, d, previous, preview)
        assert plan.status is Status.SOLVED
        np.testing.assert_allclose(plan.inputs[:, 0], np.linalg.solve(matrix.T @ matrix, matrix.T @ right), atol=1e-6)
        assert plan.input[0] == plan.inputs[0, 0]


def test_with_active_bounds_it_is_the_bounded_least_squares_solution(bounded):
    active: list[bool] = []
    for seed in range(30):
        state, d, previous, preview = instance(seed, size=2.0)
        matrix, right = least_squares_form(PROBLEM, state, d[0], previous[0], preview)
        expected = lsq_linear(matrix, right, bounds=(-10.0, 10.0), tol=1e-12, method="bvls").x
        plan = bounded.control(state, d, previous, preview)
        assert plan.status is Status.SOLVED
        np.testing.assert_allclose(plan.inputs[:, 0], expected, atol=1e-6)
        active.append(bool(np.any(np.abs(expected) > 9.999)))
    assert 5 < sum(active) < 30


def test_the_planned_states_are_where_the_planned_inputs_lead(bounded):
    state, d, previous, preview = instance(3)
    plan = bounded.control(state, d, previous, preview)
    run = simulate(LINEAR, state, (plan.inputs + d).repeat(4, axis=0), step=0.005, every=4)
    np.testing.assert_allclose(plan.states, run[1:], atol=1e-7)


def test_a_warm_start_changes_the_way_and_not_the_answer(bounded):
    random = np.random.default_rng(0)
    for seed in range(5):
        bounded.reset()
        cold = bounded.control(*instance(seed)).inputs
        for _ in range(3):
            bounded.control(*instance(int(random.integers(100, 200))))
        np.testing.assert_allclose(bounded.control(*instance(seed)).inputs, cold, atol=1e-6)


def test_a_disturbance_is_answered_by_its_opposite(bounded):
    """An offset d of the input shifts the whole plan by -d, but for the price of the first change."""
    state, preview = np.zeros(2), np.zeros((PROBLEM.horizon, 1))
    plain = bounded.control(state, np.zeros(1), np.array([0.8]), preview).inputs
    shifted = bounded.control(state, np.array([0.5]), np.array([0.3]), preview).inputs
    np.testing.assert_allclose(plain, 0.8, atol=1e-5)  # at rest on the reference: nothing to do
    np.testing.assert_allclose(shifted, 0.3, atol=1e-5)


@pytest.fixture(scope="module")
def beam_mpc(rig):
    return ExactMpc(rig.system, dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,)))


ABSURD = [1e3, -1e6, 1e12, 1e300, np.inf, -np.inf, np.nan]


@pytest.mark.parametrize("value", ABSURD)
@pytest.mark.parametrize("place", ["position", "velocity", "disturbance", "previous input", "preview"])
def test_the_input_is_finite_and_bounded_whatever_it_is_asked(beam_mpc, place, value):
    for reset in (True, False):
        state, d, previous, preview = instance(1)
        target = {"position": state[:1], "velocity": state[1:], "disturbance": d, "previous input": previous}
        target.get(place, preview)[:1] = value
        if reset:
            beam_mpc.reset()
        else:
            beam_mpc.control(*instance(2))
        plan = beam_mpc.control(state, d, previous, preview)
        assert np.all(np.isfinite(plan.inputs))
        assert np.all(np.abs(plan.inputs) <= 10.0)
        assert np.array_equal(plan.input, plan.inputs[0])
        if not np.isfinite(value):
            assert plan.status is Status.FAILED


def test_after_an_absurd_question_it_solves_sensible_ones(beam_mpc):
    """A question that can be answered, absurd as it is, is where the next search begins: that may end at another of
    stick-slip's optima, which costs hardly more. One that cannot leaves nothing.
    """
    asked, problem = instance(1), beam_mpc.problem
    yardstick = interior_point_mpc(beam_mpc.system, dataclasses.replace(problem, max_iterations=500), tolerance=1e-9)
    best = cost_by_hand(problem, yardstick.control(*asked), *asked[2:])
    beam_mpc.reset()
    cold = beam_mpc.control(*asked).inputs
    for value in ABSURD:
        answered = beam_mpc.control(np.array([value, 0.0]), *asked[1:]).status is not Status.FAILED
        for _ in range(2):
            plan = beam_mpc.control(*asked)
            assert plan.status is Status.SOLVED
            assert cost_by_hand(problem, plan, *asked[2:]) < 1.001 * best
            if not answered:
                np.testing.assert_allclose(plan.inputs, cold, atol=1e-5)
        beam_mpc.reset()
        np.testing.assert_allclose(beam_mpc.control(*asked).inputs, cold, atol=1e-5)


@pytest.mark.parametrize("real_time", [False, True])
@pytest.mark.parametrize("place", ["state", "disturbance", "preview"])
def test_a_huge_but_finite_number_is_forgotten_with_its_failure(rig, real_time, place):
    """A disturbance of 1e300 V makes the model infinite; nothing of it may stay in the memory."""
    problem = dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,))
    controller = ExactMpc(rig.system, problem, real_time=real_time)
    for started in (False, True):
        controller.reset()
        if started:
            controller.control(*instance(1))
            controller.prepare(PROBLEM.period)
        for _ in range(2):
            asked = dict(zip(("state", "disturbance", "previous", "preview"), instance(2), strict=True))
            asked[place] = np.full_like(asked[place], 1e300)
            assert np.all(np.abs(controller.control(*asked.values()).inputs) <= 10.0)
            controller.prepare(PROBLEM.period)
        sound = []
        for seed in range(20):
            sound.append(controller.control(*instance(seed)).status)
            controller.prepare(PROBLEM.period)
        assert sound.count(Status.FAILED) == 0


def test_a_question_without_numbers_gets_the_rest_of_the_last_plan(bounded):
    bounded.reset()
    state, d, previous, preview = instance(4)
    plan = bounded.control(state, d, previous, preview)
    nothing = np.full(2, np.nan)
    bounded.prepare(PROBLEM.period)
    shifted = bounded.control(nothing, d, previous, preview)
    np.testing.assert_array_equal(shifted.inputs[:-1], plan.inputs[1:])
    bounded.prepare(PROBLEM.period)
    np.testing.assert_array_equal(bounded.control(nothing, d, previous, preview).inputs[:-2], plan.inputs[2:])
    bounded.reset()
    held = bounded.control(nothing, d, np.array([3.0]), preview)  # no plan: the input before
    assert held.input[0] == 3.0
    assert len(held.states) == 0
    bounded.reset()
    assert bounded.control(nothing, d, np.array([np.nan]), preview).input[0] == 0.0


def test_out_of_iterations_it_says_so(rig):
    hasty = ExactMpc(rig.system, dataclasses.replace(PROBLEM, max_iterations=1))
    plan = hasty.control(*instance(0, size=2.0))
    assert plan.status is Status.NOT_CONVERGED
    assert np.all(np.abs(plan.inputs) <= 10.0)


def test_at_rest_on_its_reference_the_beam_is_left_alone(beam_mpc, rig):
    beam_mpc.reset()
    plan = beam_mpc.control(np.zeros(2), np.zeros(1), np.array([rig.system.centre]), np.zeros((10, 1)))
    np.testing.assert_allclose(plan.inputs, rig.system.centre, atol=0.02)


def test_a_step_that_is_announced_is_begun_before_it_comes(beam_mpc, rig):
    """That is what a preview is for."""
    beam_mpc.reset()
    preview = np.where(np.arange(1, 11) > 6, 0.04, 0.0)[:, None]
    plan = beam_mpc.control(np.zeros(2), np.zeros(1), np.array([rig.system.centre]), preview)
    assert plan.states[4, 0] > 0.001
    assert plan.inputs[:, 0].max() > 5.0


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"horizon": 0}, "horizon"),
        ({"period": -0.02}, "period"),
        ({"substeps": 0}, "substeps"),
        ({"input_high": (float("nan"),)}, "input_high"),
        ({"input_high": (-10.0,)}, "input_high"),
        ({"output_scales": (0.0,)}, "output_scales"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"rate_weights": (-1.0,)}, "rate_weights"),
        ({"rate_weights": (float("nan"),)}, "rate_weights"),
        ({"smoothing": -1.0}, "smoothing"),
        ({"input_weights": (-1.0,)}, "input_weights"),
        ({"rate_limits": (0.0,)}, "rate_limits"),
        ({"soft_quadratic": (0.0,)}, "soft_quadratic"),
        ({"state_low": (1.0,), "state_high": (-1.0,)}, "state_low"),
        ({"state_low": ("low",)}, "state_low"),
    ],
)
def test_a_problem_that_is_none_is_refused(changes, name):
    with pytest.raises(UserError, match=name):
        dataclasses.replace(PROBLEM, **changes)


def test_one_value_holds_for_all_and_another_number_is_refused():
    sized = dataclasses.replace(PROBLEM, state_low=(-1.0,), state_high=(1.0,)).sized(LINEAR)
    assert sized.state_low == (-1.0, -1.0)
    assert sized.sized(LINEAR) == sized
    with pytest.raises(UserError, match="rate_limits"):
        ExactMpc(LINEAR, dataclasses.replace(PROBLEM, rate_limits=(1.0, 2.0)))


OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "input weight": {"input_weights": (2.0,)},
    "bounds to one side": {"input_low": (-1.0,)},
    "rate limit": {"rate_limits": (1.5,)},
    "soft position": {
        "state_low": (-0.03, -np.inf),
        "state_high": (0.03, np.inf),
        "soft_linear": (3.0 / 0.0227,),
        "soft_quadratic": (100.0 / 0.0227**2,),
    },
    "soft speed": {
        "state_low": (-np.inf, -0.4),
        "state_high": (np.inf, 0.3),
        "soft_quadratic": (1e3 / 0.0227**2,),
        "rate_limits": (6.0,),
    },
}


def cost_by_hand(problem, plan, previous, preview):
    u = plan.inputs[:, 0]
    low, high = np.array(problem.state_low), np.array(problem.state_high)
    outside = np.maximum(np.maximum(plan.states - high, low - plan.states), 0.0)
    errors = (plan.states[:, 0] - preview[:, 0]) / problem.output_scales[0]
    tracking = problem.output_weights[0] * np.sum(errors**2)
    tracking += problem.rate_weights[0] * np.sum(np.diff(u, prepend=previous[0]) ** 2)
    price = np.sum(outside @ np.array(problem.soft_linear)) + np.sum(outside**2 @ np.array(problem.soft_quadratic))
    return tracking + problem.input_weights[0] * np.sum(u**2) + price


@pytest.mark.parametrize("option", OPTIONS)
def test_on_the_beam_it_finds_what_an_interior_point_solver_finds(rig, option):
    problem = dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,), **OPTIONS[option]).sized(rig.system)
    exact = ExactMpc(rig.system, problem, tolerance=1e-7)
    yardstick = interior_point_mpc(rig.system, dataclasses.replace(problem, max_iterations=500), tolerance=1e-9)
    solved, ratios = 0, []
    for seed in range(12):
        exact.reset()
        yardstick.reset()
        asked = instance(seed)
        plan, expected = exact.control(*asked), yardstick.control(*asked)
        solved += plan.status is Status.SOLVED
        ratios.append(cost_by_hand(problem, plan, *asked[2:]) / cost_by_hand(problem, expected, *asked[2:]))
        if plan.status is Status.SOLVED and abs(ratios[-1] - 1.0) < 1e-7:
            np.testing.assert_allclose(plan.inputs, expected.inputs, atol=1e-4)
            np.testing.assert_allclose(plan.states, expected.states, atol=1e-6)
    # Stick-slip has more than one optimum: the other one is not much worse, and as often better.
    assert solved == 12
    assert max(ratios) < 1.005
    assert np.mean(ratios) < 1.0005
    assert np.mean(np.abs(np.array(ratios) - 1.0) < 1e-6) >= 0.4


MILD: dict[str, dict[str, Any]] = {
    "cheap to be too fast": {
        "state_low": (-np.inf, -0.4),
        "state_high": (np.inf, 0.3),
        "soft_quadratic": (1.0 / 0.0227**2,),
    },
    "all at once": {
        "state_low": (-0.03, -0.4),
        "state_high": (0.03, 0.3),
        "soft_linear": (1.0 / 0.0227, 0.1 / 0.0227),
        "soft_quadratic": (100.0 / 0.0227**2, 10.0 / 0.0227**2),
        "rate_limits": (1.5,),
        "input_low": (-2.0,),
    },
}


@pytest.mark.parametrize("option", [*OPTIONS, *MILD])
def test_cold_starts_on_the_beam_are_solved(rig, option):
    """Far from the reference the dynamics bend the other way across active bounds, by many times Gauss-Newton's
    curvature: steps must not become short for it.
    """
    changes = {**OPTIONS, **MILD}[option]
    problem = dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,), max_iterations=50, **changes)
    exact = ExactMpc(rig.system, problem, tolerance=1e-7)
    for seed in range(60):
        exact.reset()
        assert exact.control(*instance(seed)).status is Status.SOLVED


@pytest.mark.parametrize("option", MILD)
def test_a_solved_question_that_is_asked_again_is_answered_at_once_and_the_same(rig, option):
    """Gauss-Newton's step from a solution may be long where its Hessian is nearly flat."""
    problem = dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,), max_iterations=50, **MILD[option])
    exact = ExactMpc(rig.system, problem)
    for seed in range(20):
        exact.reset()
        asked = instance(seed)
        plan, again = (exact.control(*asked) for _ in range(2))
        assert (plan.status, again.status, exact.iterations) == (Status.SOLVED, Status.SOLVED, 1)
        np.testing.assert_array_equal(again.inputs, plan.inputs)


def test_changes_of_the_input_stay_within_their_limit(rig):
    problem = dataclasses.replace(PROBLEM, output_scales=(rig.display[0].scale,), rate_limits=(0.7,))
    controller = ExactMpc(rig.system, problem)
    for seed in range(5):
        state, d, previous, preview = instance(seed, size=2.0)
        plan = controller.control(state, d, previous, preview)
        changes = np.diff(plan.inputs[:, 0], prepend=previous[0])
        assert np.max(np.abs(changes)) <= 0.7 + 1e-6
        assert np.max(np.abs(changes)) == pytest.approx(0.7)
