"""The exact MPC when time counts: one iteration a call, and a limit of time."""

import dataclasses

import numpy as np
import pytest

from benchmarks.mpc_speed import cases, loop
from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.mpc.sequential import ASSURED
from hybrid_sysid_ros.control.terms import StageTerm
from hybrid_sysid_ros.core import simulate
from tests.control.beam_problem import PROBLEM


def test_a_real_time_iteration_follows_the_optimum(rig):
    """One step a call on a slowly moving reference stays near the converged solution."""
    converged, iterated = ExactMpc(rig.system, PROBLEM), ExactMpc(rig.system, PROBLEM, real_time=True)
    x, u, apart = np.zeros(2), np.array([rig.system.centre]), []
    for k in range(150):
        preview = 0.05 * np.sin(2 * np.pi * 0.5 * PROBLEM.period * (k + np.arange(1, 11)))[:, None]
        exact, quick = (each.control(x, np.zeros(1), u, preview) for each in (converged, iterated))
        apart.append(abs(exact.input[0] - quick.input[0]))
        assert quick.status in ((Status.ITERATED, Status.SOLVED) if k else (Status.SOLVED,))
        u = quick.input
        for each in (converged, iterated):
            each.prepare(PROBLEM.period)
        x = simulate(rig.system, x, np.tile(u, (4, 1)), step=0.005)[-1]
    assert np.median(apart) < 0.001  # but for the moments when the beam turns round


def test_a_period_linearises_twice_only_where_a_prepared_step_did_not_cost_what_was_predicted(rig):
    """At rest where it should be the beam is as predicted. Pushed it is not, and until it is again nothing is prepared.

    Who linearised is seen by the derivatives that it leaves.
    """
    controller = ExactMpc(rig.system, PROBLEM, real_time=True)
    rest, u, linear = np.array([0.03, 0.0]), np.array([rig.system.centre]), controller.shooting.horizon.linear
    x, prepared, linearised, foreseen = rest, [False], [], controller.shooting.horizon.progress["foreseen"]
    for k in range(60):
        x = x + (k == 20) * np.array([-0.1, 1.5])
        before = linear.A.copy()
        u = controller.control(x, np.zeros(1), u, np.full((10, 1), 0.03)).input
        linearised.append(not np.array_equal(linear.A, before))
        before = linear.A.copy()
        controller.prepare(PROBLEM.period)
        prepared.append(not np.array_equal(linear.A, before))
        assert prepared[-1] == (foreseen[0] >= ASSURED)
        x = simulate(rig.system, x, np.tile(u, (4, 1)), step=0.005)[-1] if 20 <= k < 40 else rest
    done = np.array(linearised, int) + np.array(prepared[:-1])
    assert done.tolist() == [1] * 21 + [2] + [1] * 38, "and never less than once"
    assert prepared[21], "at rest it was prepared"
    assert not any(prepared[22:50])
    assert all(prepared[51:]), "and is so again"


@pytest.mark.parametrize("constant", [-1e3, 1e3])
def test_a_constant_in_the_cost_changes_neither_a_plan_nor_when_one_is_prepared(rig, constant):
    def answers(value):
        priced = StageTerm(name="priced", value=value, price=0.01)
        mpc = ExactMpc(rig.system, dataclasses.replace(PROBLEM, terms=(priced,)), real_time=True)
        random, x, u, found = np.random.default_rng(1), np.zeros(2), np.array([rig.system.centre]), []
        for k in range(80):
            preview = np.full((10, 1), 0.05 if (k // 40) % 2 else -0.05)
            u = mpc.control(x, np.zeros(1), u, preview).input
            mpc.prepare(PROBLEM.period)
            found.append((*u, *mpc.shooting.horizon.progress["foreseen"]))
            x = simulate(rig.system, x, np.tile(u, (4, 1)), step=0.005)[-1] + random.normal(size=2) * (0.0, 0.02)
        return np.array(found)

    plain = answers("position")
    assert 0.0 < np.mean(plain[:, 1] > 0.0) < 1.0, "some costs are foreseen, and some are not"
    np.testing.assert_allclose(answers(f"position + {constant}"), plain, atol=1e-7)


def test_on_the_lecture_s_polynomial_one_iteration_a_call_costs_little():
    """Its gain changes sign within the inputs' range: a step by the curvature of another moment runs away."""
    pytest.importorskip("hybrid_sysid_ros.extensions.narx")
    case = dataclasses.replace(cases()["lecture"], samples=100)
    converged, iterated = (ExactMpc(case.system, case.problem, real_time=quick) for quick in (False, True))
    assert loop(case, 0, iterated)["cost"] < 1.02 * loop(case, 0, converged)["cost"]


@pytest.mark.parametrize("name", ["network", "beam"])
def test_a_step_that_nobody_checks_is_the_prepared_program_s_and_costs_no_more(name):
    """Diehl's real-time iteration: its states keep gaps, and nothing simulates them in the call."""
    case = dataclasses.replace(cases()[name], samples=60)
    converged = ExactMpc(case.system, case.problem)
    plain = ExactMpc(case.system, case.problem, real_time=True, checked=False)
    assert loop(case, 0, plain)["cost"] < 1.005 * loop(case, 0, converged)["cost"]
    simulated = plain.shooting.horizon.simulated
    simulated[:] = 7.0
    asked = np.zeros(len(case.system.states)), np.zeros(1), np.zeros(1), np.ones((case.problem.horizon, 1))
    assert plain.control(*asked).status is Status.ITERATED
    assert (simulated == 7.0).all()


def test_out_of_time_the_rest_of_the_last_plan_stands_in(rig):
    seconds = iter(np.arange(0.0, 1e6, 1.0))  # every look at this clock is a second later
    controller = ExactMpc(rig.system, PROBLEM, tolerance=0.0, time_limit=0.5, clock=lambda: next(seconds))
    state, d, previous = np.array([0.03, -0.1]), np.array([0.2]), np.array([2.0])
    preview = 0.05 * np.linspace(-1.0, 1.0, 10)[:, None]
    assert controller.control(state, d, previous, preview).status is Status.LATE  # no plan yet: the input before
    assert controller.control(state, d, previous, preview).input[0] == previous[0]
    unhurried = ExactMpc(rig.system, PROBLEM, time_limit=1e9, clock=lambda: 0.0)
    plan = unhurried.control(state, d, previous, preview)
    assert plan.status is Status.SOLVED
    unhurried._tolerance, unhurried._time_limit, unhurried._clock = 0.0, 0.5, lambda: next(seconds)
    unhurried.prepare(PROBLEM.period)
    late = unhurried.control(state, d, previous, -preview)
    assert late.status is Status.LATE
    np.testing.assert_array_equal(late.inputs[:-1], plan.inputs[1:])
