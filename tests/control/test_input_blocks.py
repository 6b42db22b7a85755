"""Blocks through which inputs are held, and uneven intervals: IPOPT's optimum, of a program with fewer variables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, StageTerm, Status
from hybrid_sysid_ros.control.mpc.shooting import shooting
from hybrid_sysid_ros.control.steady_motion import steady_motion
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.runtime.mpc_section import about
from hybrid_sysid_ros.support.errors import UserError
from tests.control.test_terms import ARMS, STAGE, TERMS
from tests.control.two_inputs import PROBLEM, instance

CASES: dict[str, dict[str, Any]] = {
    "intervals": {"intervals": [1, 1, 2, 3, 5]},
    "blocks": {"blocks": [1, 2, 3]},
    "blocks across intervals": {"intervals": [1, 1, 2, 2, 6], "blocks": [2, 3, 4]},
    "rates": {"intervals": [1, 1, 2, 3, 5], "rate_limits": (0.3, np.inf)},
    "bounded states": {
        "intervals": [1, 1, 2, 2, 3, 3],
        "state_high": (0.1, np.inf, np.inf, np.inf),
        "soft_linear": (3.0,),
        "soft_quadratic": (40.0,),
    },
    "terms": {"intervals": [1, 1, 2, 3, 5], "terms": TERMS, "stage_parameters": STAGE},
}


@pytest.mark.parametrize("name", CASES)
def test_the_optimum_is_that_of_ipopt_and_held_through_blocks(name):
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    problem = replace(PROBLEM, **CASES[name])
    exact, yardstick = ExactMpc(ARMS, problem), found.InteriorPointMpc(ARMS, problem, tolerance=1e-9)
    assert exact.shooting.program.gradient.size == 2 * (problem.moves[-1] + 1)
    for seed in range(3):
        exact.reset()
        yardstick.reset()
        plan, best = exact.control(*instance(seed)), yardstick.control(*instance(seed))
        assert plan.status is best.status is Status.SOLVED
        cost, least = (exact.follow(item.inputs)[0] for item in (plan, best))
        assert cost == pytest.approx(least, rel=1e-6)
        np.testing.assert_allclose(np.diff(plan.inputs, axis=0)[np.diff(problem.moves) == 0], 0.0, atol=1e-9)


def test_blocks_of_one_period_are_the_plain_problem():
    alike = replace(PROBLEM, intervals=(1,) * PROBLEM.horizon, blocks=(1,) * PROBLEM.horizon)
    one, other = (ExactMpc(ARMS, problem).control(*instance(1)).inputs for problem in (PROBLEM, alike))
    np.testing.assert_array_equal(one, other)


def test_inputs_cost_nothing_at_an_operating_point():
    rest = about(ARMS, PROBLEM, [0.2, 0.0])
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    point = steady_motion(ARMS, rest, np.array([0.2, 0.0]))
    asked = point.state, np.zeros(2), point.inputs, np.tile([0.2, 0.0], (12, 1))
    for solver in (ExactMpc(ARMS, rest), found.InteriorPointMpc(ARMS, rest, tolerance=1e-9)):
        np.testing.assert_allclose(solver.control(*asked).inputs, np.tile(rest.input_rest, (12, 1)), atol=1e-5)
    assert np.abs(ExactMpc(ARMS, PROBLEM).control(*asked).inputs[-1] - point.inputs).max() > 1e-3
    with pytest.raises(UserError, match="no inputs hold the outputs at"):
        about(ARMS, PROBLEM, [2.0, 0.0])
    with pytest.raises(UserError, match=r"first_torque would be .*, beyond its bounds -0\.01 and 0\.01"):
        about(ARMS, replace(PROBLEM, input_low=(-0.01,), input_high=(0.01,)), [0.2, 0.0])


@dataclass(frozen=True, kw_only=True)
class Basin(System):
    """x' = pump + 2 spring - x: two inputs for one level."""

    states = ("level [m]",)
    inputs = ("pump [m/s]", "spring [m/s]")

    def law(self, x, u):
        return (u[0] + 2.0 * u[1] - x[0],)


@pytest.mark.parametrize(
    ("weights", "most", "expected"),
    [((1.0, 1.0), 10.0, (0.2, 0.4)), ((1.0, 4.0), 10.0, (0.5, 0.25)), ((1.0, 1.0), 0.3, (0.4, 0.3))],
)
def test_of_the_inputs_that_hold_an_output_the_cheapest_within_their_bounds_are_taken(weights, most, expected):
    """Level 1 needs pump + 2 spring = 1: by Lagrange, spring / pump = 2 R_pump / R_spring."""
    problem = ControlProblem(
        horizon=5,
        period=0.1,
        substeps=1,
        output_weights=(1.0,),
        input_weights=weights,
        input_low=(0.0,),
        input_high=(10.0, most),
    )
    assert about(Basin(), problem, [1.0]).input_rest == pytest.approx(expected, abs=1e-6)


def test_a_real_time_iteration_stays_near_the_optimum():
    problem = replace(PROBLEM, intervals=(1, 1, 2, 3, 5), rate_limits=(0.3, np.inf))
    solvers = ExactMpc(ARMS, problem), ExactMpc(ARMS, problem, real_time=True)
    state, disturbance, previous, preview = instance(2)
    for _ in range(8):
        plans = [mpc.control(state, disturbance, previous, preview) for mpc in solvers]
        state, previous = plans[0].states[0], plans[0].input
        for mpc in solvers:
            mpc.prepare(problem.period)
    assert plans[1].status is Status.ITERATED
    np.testing.assert_allclose(plans[1].input, plans[0].input, atol=0.02)


def test_a_program_has_no_rows_where_nothing_is_bounded():
    term = (StageTerm(name="late", value="first", high=0.1, final=True),)
    plain, held = (shooting(ARMS, replace(PROBLEM, terms=term, blocks=blocks)) for blocks in ((), (3, 3)))
    assert len(plain.program.rows) == len(held.program.rows) == 1
    assert held.program.gradient.size == 4


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"intervals": [1, 1, 2]}, "have 4 periods together; they need exactly the horizon's 12"),
        ({"intervals": [6, 7]}, "13 periods together; they need exactly"),
        ({"blocks": [6, 7]}, "blocks have 13 periods together; they need at most the horizon's 12"),
        ({"blocks": [0, 12]}, "blocks has 0; give whole numbers"),
        ({"blocks": [-1]}, "has -1"),
        ({"intervals": [1.5, 10.5]}, "has 1.5"),
        ({"intervals": [float("nan")]}, "has nan"),
        ({"blocks": "2"}, "has '2'"),
        ({"intervals": True}, "has True"),
    ],
)
def test_wrong_lengths_are_refused(given, said):
    with pytest.raises(UserError, match=said):
        replace(PROBLEM, **given)
