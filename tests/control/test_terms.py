"""Terms of a problem: the optimum is IPOPT's, what can be said in two ways is the same, and what is wrong is named."""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, replace
from typing import Any

import casadi
import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.mpc.horizon import new_instance
from hybrid_sysid_ros.control.safety.supervision import _allowed
from hybrid_sysid_ros.control.terms import terms_of, with_terms
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.core.intervals import enclosed
from hybrid_sysid_ros.core.symbolic import symbolic_output
from hybrid_sysid_ros.support.errors import UserError
from tests.control.two_inputs import PROBLEM, Arms, instance
from tests.model_samples import FROM_DATA

ARMS = Arms(friction=0.0)
TERMS = {
    "power": {"value": "first_torque * first_rate + second_torque * second_rate", "price": 0.5},
    "low": {"value": "cos(first) - limit", "high": 0.0, "soft_linear": 5.0, "soft_quadratic": 50.0},
    "disc": {"value": "first_torque**2 + second_torque**2", "high": 1.5, "hard": True},
    "together": {"value": "first - second", "weight": 20.0, "final": True},
}
LINE = {"value": "first_torque + second_torque", "low": 3.2, "hard": True}
STAGE = {"limit": np.linspace(0.95, 0.9, PROBLEM.horizon)}


def declared(**changes: Any) -> ControlProblem:
    return replace(PROBLEM, **{"terms": TERMS, "stage_parameters": STAGE, **changes})


@pytest.fixture(scope="module")
def solver():
    return ExactMpc(ARMS, declared())


def test_the_optimum_is_that_of_ipopt(solver):
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    yardstick = found.InteriorPointMpc(ARMS, declared(), tolerance=1e-9)
    for seed in range(3):
        for mpc in (solver, yardstick):
            mpc.reset()
            mpc.assign(limit=STAGE["limit"] - 0.02 * seed)
        plan, best = solver.control(*instance(seed)), yardstick.control(*instance(seed))
        assert plan.status is best.status is Status.SOLVED
        cost, least = (solver.follow(item.inputs)[0] for item in (plan, best))
        assert cost == pytest.approx(least, rel=1e-6)
        assert np.all(np.sum(plan.inputs**2, axis=1) <= 1.5 + 1e-6)
    solver.assign(**STAGE)


@pytest.mark.parametrize("rates", [(0.6, 0.15), (0.6, 0.05)])
def test_hard_bounds_and_limits_of_rates_hold_together(rates):
    problem = declared(terms={"disc": TERMS["disc"]}, stage_parameters={}, rate_limits=rates)
    previous, preview = np.array([0.9, -0.8]), np.tile([0.9, 0.0], (PROBLEM.horizon, 1))  # just within the disc
    state, disturbance, _, _ = instance(0)
    plan = ExactMpc(ARMS, problem).control(state, disturbance, previous, preview)
    assert plan.status is Status.SOLVED
    assert np.sum(plan.inputs**2, axis=1).max() == pytest.approx(1.5, abs=1e-9)
    assert np.all(np.abs(np.diff(plan.inputs, axis=0, prepend=previous[None])) <= np.array(rates) + 1e-12)


@pytest.mark.parametrize("planned", [True, False])
def test_a_hard_bound_that_drops_is_reached_as_fast_as_the_limits_of_rates_allow(planned):
    """Until then there is no solution."""
    circle = {"value": "first_torque**2 + second_torque**2 - limit", "high": 0.0, "hard": True}
    problem = declared(terms={"circle": circle}, stage_parameters={"limit": 1.5}, rate_limits=(0.1,))
    mpc, (state, disturbance, *_), u = ExactMpc(ARMS, problem), instance(0), np.array([0.8, 0.8])
    preview, found = np.tile([0.9, 0.9], (PROBLEM.horizon, 1)), []
    if planned:
        u = mpc.control(state, disturbance, u, preview).input
    mpc.assign(limit=0.5)
    for _ in range(5):
        plan = mpc.control(state, disturbance, u, preview)
        assert np.all(np.abs(np.diff(plan.inputs, axis=0, prepend=u[None])) <= 0.1 + 1e-12)
        u = plan.input
        found.append((plan.status, float(np.sum(u**2))))
        mpc.prepare(PROBLEM.period)
    assert found[0][0] is Status.FAILED
    within = [status for status, size in found if size <= 0.5 + 1e-9]
    assert len(within) >= 2
    assert set(within) == {Status.SOLVED}


def test_a_hard_bound_holds_after_a_disturbance_that_nothing_has():
    """Where d is 1e12, (u + d) - d is off u by 1e-4; where the next step is made, d is another."""
    disc = declared(terms={"disc": TERMS["disc"]}, stage_parameters={})
    mpc, rng, u = ExactMpc(ARMS, disc, real_time=True, checked=False), np.random.default_rng(0), np.zeros(2)
    for _ in range(600):
        state, disturbance, _, preview = instance(int(rng.integers(20)))
        size = 1e12 if rng.random() < 0.2 else 0.0
        scale, preview[:] = rng.normal(), 2.0 * rng.normal(size=preview.shape[1])
        u = mpc.control(state * scale, disturbance + size, u, preview).input
        assert np.sum(u**2) <= 1.5 + (1e-3 if size else 1e-9)
        mpc.prepare(PROBLEM.period)


def test_an_output_that_is_tracked_by_a_term_is_tracked_as_by_its_weight():
    asked = instance(2)
    asked[3][:] = (0.3, 0.0)
    terms = {"error": {"value": "height - wanted", "weight": 200.0}, "load": {"value": "load", "weight": 2.0}}
    by_terms = ExactMpc(ARMS, declared(output_weights=(0.0,), terms=terms, stage_parameters={"wanted": 0.3})).control(
        *asked
    )
    assert by_terms.status is Status.SOLVED
    np.testing.assert_allclose(by_terms.inputs, ExactMpc(ARMS, PROBLEM).control(*asked).inputs, atol=1e-5)


def test_a_bound_on_a_state_is_the_same_as_a_term(solver):
    soft = {"soft_linear": 3.0, "soft_quadratic": 40.0}
    plain = replace(PROBLEM, state_high=(0.1, np.inf, np.inf, np.inf), soft_linear=(3.0,), soft_quadratic=(40.0,))
    term = declared(terms={"first_high": {"value": "first", "high": 0.1, **soft}})
    plans = [ExactMpc(ARMS, problem).control(*instance(1)).inputs for problem in (plain, term)]
    np.testing.assert_allclose(plans[0], plans[1], atol=1e-5)


def test_a_declaration_is_plain_data():
    problem = declared()
    assert ControlProblem(**asdict(problem)) == problem
    assert hash(problem) == hash(declared())


@pytest.mark.parametrize(
    ("term", "said"),
    [
        ({"value": "spede**2", "price": 1.0}, "spede is unknown"),
        ({"value": "sine(first)", "price": 1.0}, "function sine is unknown"),
        ({"value": "max(first, 0)", "price": 1.0}, "max is not smooth"),
        ({"value": "first +", "price": 1.0}, "is no formula"),
        ({"value": "first > 0", "price": 1.0}, "is no part of a formula"),
        ({"value": "__import__('os')", "price": 1.0}, "__import__ is unknown"),
        ({"value": "1 / 0", "price": 1.0}, "is not a number"),
        ({"value": "1 / first", "price": 1.0}, "term broken is not finite"),
        ({"value": "hypot(first, second)", "price": 1.0}, "term broken has no finite derivatives"),
        ({"value": "first", "high": 1.0, "hard": True}, "a hard bound is for inputs alone"),
        ({"value": "3", "price": 1.0}, "3 has neither states nor inputs"),
        ({"value": "limit**2", "price": 1.0}, "has neither states nor inputs"),
        ({"value": "first"}, "has no effect"),
        ({"value": "first", "weight": -1.0}, "at least 0"),
        ({"value": "first", "price": float("nan")}, "needs a number"),
        ({"value": "first", "price": [1.0, 2.0]}, "one for each of the 12 stages"),
        ({"value": "first", "low": 1.0, "high": 0.0}, "is not below"),
        ({"value": "first", "wieght": 1.0}, "unknown key 'wieght'"),
        ({"price": 1.0}, "needs a name and a formula"),
        ("first", "has no effect"),
        (3.0, "needs a name and a formula"),
    ],
)
def test_a_wrong_term_is_refused_by_its_name(term, said):
    with pytest.raises(UserError, match=said) as refused:
        declared(terms={"broken": term}).sized(ARMS)
    assert "broken" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_hard_bounds_that_leave_no_input_are_named_with_their_stage():
    high = {"value": "first_torque - second_torque - limit", "high": 0.0, "hard": True}
    low = {"value": "first_torque - second_torque", "low": 0.5, "hard": True}
    limit = np.where(np.arange(PROBLEM.horizon) < 4, 1.0, 0.4)
    with pytest.raises(UserError, match="the hard bounds of low and high leave no input at stage 5"):
        declared(terms={"low": low, "high": high}, stage_parameters={"limit": limit}).sized(ARMS)
    declared(terms={"low": low, "high": high}, stage_parameters={"limit": limit + 0.2}).sized(ARMS)
    with pytest.raises(UserError, match="the hard bounds of low leave no input at stage 1"):
        declared(terms={"low": {**low, "low": 1e3}}).sized(ARMS)


def test_hard_bounds_that_bend_and_leave_no_input_are_named_too():
    """Between a disc and a line beside it: sqrt(2) from the origin, where the inputs' own bounds are wider."""
    ring = {"value": "sqrt(first_torque**2 + second_torque**2 + 1e-12)", "high": 1.0, "hard": True}
    line = {**LINE, "value": f"{LINE['value']} - limit", "low": 0.0}
    sine = {"value": "sin(first_torque)", "high": 0.9, "hard": True}
    limit = np.where(np.arange(PROBLEM.horizon) < 4, math.sqrt(2.0) - 1e-3, math.sqrt(2.0) + 1e-3)
    given = {"terms": {"sine": sine, "ring": ring, "line": line}}
    with pytest.raises(UserError, match="the hard bounds of ring and line leave no input at stage 5"):
        declared(**given, stage_parameters={"limit": limit}).sized(ARMS)
    mpc = ExactMpc(ARMS, declared(**given, stage_parameters={"limit": limit - 2e-3}))
    mpc.assign(limit=limit)
    with pytest.raises(UserError, match="the hard bounds of ring and line leave no input at stage 5"):
        mpc.check()
    with pytest.raises(UserError, match="the hard bounds of ring leave no input at stage 1, "):
        declared(terms={"ring": {**ring, "low": 4.0, "high": 5.0}}).sized(ARMS)
    with pytest.raises(UserError, match="the hard bounds of sine and line leave no input at stage 12, "):
        declared(terms={"sine": {**sine, "low": 0.9, "high": 1.0}, "line": {**LINE, "final": True}}).sized(ARMS)


@pytest.mark.parametrize("value", ["log(0.5 - first)", "sqrt(0.5 - first)"])
def test_a_plan_whose_cost_is_no_number_is_no_solution(value):
    """Its arm swings past the end of what the formula is defined for, whatever the torque."""
    mpc = ExactMpc(ARMS, declared(terms={"near": {"value": value, "price": 1.0}}, stage_parameters={}))
    _, disturbance, previous, preview = instance(0)
    plan = mpc.control(np.array([0.45, 0.0, 3.0, 0.0]), disturbance, previous, preview)
    assert plan.status is Status.FAILED
    row = np.concatenate([[0.45, 0.0, 3.0, 0.0], disturbance, previous, preview.ravel()])
    assert not mpc.solve_many(row[None], threads=1).solved.any()


def test_soft_bounds_that_contradict_each_other_are_named():
    """One value can't be on both sides; at most 0 and at least 0 is a point."""
    below = {"value": "first", "high": 0.0}
    with pytest.warns(RuntimeWarning, match="bounds of above and below contradict.*at least 1 and at most 0"):
        declared(terms={"below": below, "above": {"value": "first", "low": 1.0}}).sized(ARMS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        declared(terms={"below": below, "above": {"value": "first", "low": 0.0}}).sized(ARMS)


def test_hard_bounds_that_seem_to_leave_no_input_are_told_as_a_guess():
    """An angle is never above pi, but over a box its bounds are not known here."""
    angle = "atan2(second_torque, first_torque + 1e-9)"
    ring = {"value": "first_torque**2 + second_torque**2", "low": 0.99, "high": 1.0, "hard": True}
    turned = {"value": angle, "low": 3.2, "hard": True}
    with pytest.warns(RuntimeWarning, match="ring and turned perhaps leave no input at stage 1.*beyond one of them"):
        declared(terms={"ring": ring, "turned": turned}, stage_parameters={}).sized(ARMS)


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-5])
def test_hard_bounds_that_meet_at_a_small_angle_hold(gap):
    """A disc and a line that cuts off a segment of this height: all inputs are near one point."""
    disc = {"value": "first_torque**2 + second_torque**2", "high": 1.0, "hard": True}
    line = {"value": "first_torque + second_torque", "low": math.sqrt(2.0) * (1.0 - gap), "hard": True}
    plan = ExactMpc(ARMS, declared(terms={"disc": disc, "line": line})).control(*instance(0))
    assert plan.status is Status.SOLVED
    assert np.all(np.sum(plan.inputs**2, axis=1) <= 1.0 + 1e-9)
    assert np.all(np.sum(plan.inputs, axis=1) >= line["low"] - 1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_intervals_enclose_what_a_function_is_within_a_box(seed):
    functions = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "fabs")
    u = casadi.SX.sym("u", 2)
    values = [getattr(casadi, name)(u[0]) for name in functions] + [u[0] * u[1], u[0] / u[1], u[0] ** -3, u[0] ** u[1]]
    values += [u[0] ** 2 - u[1], u[0] ** 4, u[0] ** 3, u[0] ** 1.5, casadi.hypot(u[0], u[1]), casadi.atan2(u[0], u[1])]
    function, random = casadi.Function("values", [u], [casadi.vertcat(*values)]), np.random.default_rng(seed)
    low = random.uniform(-3.0, 3.0, (200, 2))
    high = low + random.uniform(0.0, 3.0, low.shape)
    lowest, highest = enclosed(function, (low, high))
    assert np.isfinite(highest).mean() > 0.5
    for _ in range(20):
        at = low + (high - low) * random.uniform(size=low.shape)
        with np.errstate(invalid="ignore"):
            found = function(at.T).full().T
        known = ~np.isnan(found)
        assert np.all((lowest - 1e-9 * np.abs(found) <= found)[known])
        assert np.all((found <= highest + 1e-9 * np.abs(found))[known])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"limit": [1.0, 2.0]}, "limit has 2 values; it needs one, or 12"),
        ({"limit": float("inf")}, "limit is not finite"),
        ({"limit": "high"}, "it needs numbers"),
        ({"first": 1.0, "limit": 1.0}, "first has the name of something else"),
        ([("limit", 1.0), ("limit", 2.0)], "limit is there twice"),
        (3, "stage_parameters is 3; give names with values"),
        (["limit"], "give names with values"),
    ],
)
def test_stage_parameters_that_do_not_fit_are_refused(values, said):
    with pytest.raises(UserError, match=said):
        declared(stage_parameters=values).sized(ARMS)


def test_in_real_time_new_stage_parameters_count_at_once():
    early, late = (ExactMpc(ARMS, declared(), real_time=True) for _ in range(2))
    for mpc, order in ((early, "ap"), (late, "pa")):
        mpc.control(*instance(0))
        for part in order:
            mpc.prepare(PROBLEM.period) if part == "p" else mpc.assign(limit=STAGE["limit"] - 0.05)
    asked = instance(0)
    np.testing.assert_array_equal(early.control(*asked).inputs, late.control(*asked).inputs)


def test_a_plan_of_a_network_keeps_the_hard_bounds(solver):
    @kernel
    def allowed(prediction, horizon, asked, inputs):
        return _allowed(prediction, horizon, asked, inputs)

    inputs = np.zeros((PROBLEM.horizon, 2))
    inputs[4] = np.sqrt(0.75)  # on the disc's edge, but for rounding
    memory, (_, asked) = solver.shooting, new_instance(ARMS, declared().sized(ARMS))
    assert allowed(memory.prediction, memory.horizon, asked, inputs)
    inputs[4] += 1e-6
    assert not allowed(memory.prediction, memory.horizon, asked, inputs)


def test_the_cost_of_a_loop_has_the_terms_of_its_stages():
    problem, states = declared().sized(ARMS), np.array([[0.1, 0.2, 0.5, -0.4], [0.0, 0.1, 0.2, 0.3]])
    inputs, none = np.array([[0.4, 0.1], [0.2, -0.3]]), np.zeros((2, 2))
    loop = ClosedLoop(time=np.array([0.0, 0.1]), outputs=none, estimates=states, references=none, inputs=inputs)
    first, rates = states[:, 0], states[:, 2:]
    beyond = np.maximum(np.cos(first) - 0.95, 0.0)
    terms = np.sum(0.5 * np.sum(inputs * rates, axis=1) + (5.0 + 50.0 * beyond) * beyond)
    assert loop.cost_by(problem, ARMS) - loop.cost_by(problem) == pytest.approx(terms)


def test_an_unknown_stage_parameter_is_refused_later_too(solver):
    with pytest.raises(UserError, match="no stage parameter limits: known are limit"):
        solver.assign(limits=1.0)
    with pytest.raises(UserError, match="no stage parameter limits: the problem has none"):
        replace(solver.problem, terms=(), stage_parameters=()).assign(np.zeros((1, 0)), {"limits": 1.0})


@pytest.mark.parametrize("structure", FROM_DATA)
def test_a_term_of_an_output_holds_for_structures_made_of_their_data(structure):
    """Their parameters have no attributes that a formula could name."""
    system = FROM_DATA[structure]
    whole = with_terms(system, terms_of({"square": {"value": f"{system.outputs[0].name}**2", "price": 1.0}}), ())
    x, u = np.full(len(system.states), 0.01), np.full(len(whole.inputs), 0.02)
    *outputs, square = np.array(symbolic_output(whole)(x, u)).ravel()
    assert square == pytest.approx(outputs[0] ** 2, rel=1e-12)


@pytest.mark.parametrize("weights", [(-1.0,), (math.nan,), "x", 5j])
def test_final_weights_that_are_none_are_refused(weights):
    with pytest.raises(UserError, match="final_output_weights"):
        declared(final_output_weights=weights)


def test_no_final_weights_of_a_file_are_those_of_the_default():
    assert hash(declared(final_output_weights=[])) == hash(declared())
