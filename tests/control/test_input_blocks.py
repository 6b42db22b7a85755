"""Blocks through which inputs are held, and uneven intervals: IPOPT's optimum, of a program with fewer variables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc, StageTerm, Status
from hybrid_sysid_ros.control.mpc.shooting import shooting
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
