"""The check of a plan, against a cost worked out by hand."""

import dataclasses

import numpy as np
import pytest
from linear_policies import BEAM, BROKEN_BY, CASES, SMALL, broken_policy, exact_policy  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.shooting import rollout
from hybrid_sysid_ros.control.safety.supervision import (
    ACCEPTED,
    COSTLIER,
    DISTURBED,
    INFEASIBLE,
    OUT_OF_RANGE,
)
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor
from hybrid_sysid_ros.support.errors import UserError
from tests.supervised import TOLERANCES, bad, checked, flat, instances, policy_shifted, supervisor_of

FENCE = 0.01
LIMITS = {"state_low": (-FENCE, -1e3), "state_high": (FENCE, 1e3), "soft_quadratic": (1e-3,) * 2}
FENCED = dataclasses.replace(BEAM, problem=dataclasses.replace(BEAM.problem, **LIMITS))
"""The beam with bounds of its position that cost next to nothing, so the exact law is still linear."""


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]


def test_the_cost_of_a_plan_is_that_of_the_problem(case):
    """By hand it is the sum of squares whose minimum is the optimum."""
    shooting = ExactMpc(case.system, case.problem).shooting
    for instance in instances(case, 20):
        inputs = 5 * np.random.default_rng(1).normal(size=shooting.horizon.inputs.shape)
        states = np.empty_like(shooting.horizon.states)
        cost, outside = rollout(shooting.prediction, shooting.horizon.weights, Instance(*instance), inputs, states)
        matrix, right = case.least_squares(flat(instance))
        assert cost == pytest.approx(np.sum((matrix @ inputs.ravel() - right) ** 2), rel=1e-9)
        assert outside == 0.0


def test_a_plan_as_good_as_the_last_one_is_accepted_and_a_costlier_one_is_not(case):
    law, broken = exact_policy(case), broken_policy(case)
    worse = 2 * BROKEN_BY * (np.arange(case.b.shape[1]) == 0)
    for instance in instances(case, 10):
        best = case.plan(flat(instance))
        assert checked(case, law, instance, best) == ACCEPTED
        assert checked(case, broken, instance, best) == ACCEPTED  # sound below zero
        best = case.plan(flat(bad(instance)))
        assert checked(case, law, bad(instance), best) == ACCEPTED
        assert checked(case, broken, bad(instance), best) == COSTLIER
        assert checked(case, broken, bad(instance), best + worse) == ACCEPTED  # better than that it is


def test_the_tolerance_is_a_share_and_a_floor(case):
    """Beside a last plan whose cost is known, the network's is accepted up to exactly that cost."""
    instance = next(instances(case, 1))
    matrix, right = case.least_squares(flat(instance))
    best = case.plan(flat(instance))
    cost = np.sum((matrix @ best.ravel() - right) ** 2)
    worse = policy_shifted(exact_policy(case), 0.3)
    costlier = np.sum((matrix @ (best.ravel() + 0.3) - right) ** 2)
    for share, floor in ((0.0, costlier - cost), (costlier / cost - 1.0, 0.0)):
        just, short = (TOLERANCES._replace(cost=share * k, floor=floor * k) for k in (1.001, 0.999))
        assert checked(case, worse, instance, best, just) == ACCEPTED
        assert checked(case, worse, instance, best, short) == COSTLIER


def creeping_policy(case, units):
    """All of its inputs are the one before, and so much more."""
    law, (n, m) = exact_policy(case), case.b.shape
    (gains, zeros), (matrix, bias) = law.layers
    kept = np.zeros_like(gains)
    kept[: len(bias), n + m] = SMALL
    half = 0.5 * (case.problem.input_high[0] - case.problem.input_low[0])
    return dataclasses.replace(law, layers=((kept, zeros), (matrix, np.full(len(bias), units / half))))


def test_it_tells_why(case):
    law, instance = exact_policy(case), next(instances(case, 1))
    best = case.plan(flat(instance))
    state, d, previous, preview = instance
    for j in range(len(d)):
        assert checked(case, law, (state, np.where(np.arange(len(d)) == j, -1.5, d), previous, preview), best) == (
            DISTURBED
        )
    assert checked(case, law, (state + 2e3, d, previous, preview), best) == OUT_OF_RANGE
    assert checked(case, law, (state * np.nan, d, previous, preview), best) == OUT_OF_RANGE
    assert checked(case, law, (state, d * np.nan, previous, preview), best) == OUT_OF_RANGE


def test_a_state_may_be_out_of_its_bounds_by_the_tolerance_wherever_the_last_plan_leads():
    policy, centre = exact_policy(FENCED), FENCED.system.centre
    rest, far = (np.zeros(2), np.zeros(1), np.array([centre])), np.full((FENCED.problem.horizon, 1), 0.05)
    x, outside, towards = np.zeros(2), 0.0, FENCED.plan(flat((*rest, far)))
    for u in towards:
        x = FENCED.a @ x + FENCED.b @ u + FENCED.offset
        outside = max(outside, x[0] - FENCE)
    just, short = (TOLERANCES._replace(violation=outside + more, floor=1e6) for more in (1e-9, -1e-9))
    for last_plan in (np.full(FENCED.problem.horizon, centre), towards, towards + 1.0):
        assert checked(FENCED, policy, (*rest, far), last_plan, just) == ACCEPTED
        assert checked(FENCED, policy, (*rest, far), last_plan, short) == INFEASIBLE


def test_plans_that_are_each_a_little_further_out_than_the_last_one_do_not_creep_out():
    """As long as a network drives, no state gets beyond the tolerance, whatever it answers: here the last input and a
    little more, of which each step takes the plan out by less than is allowed.
    """
    supervisor = supervisor_of(FENCED, creeping_policy(FENCED, 0.002), TOLERANCES._replace(floor=1e6))
    x, u, reference = np.zeros(2), np.array([FENCED.system.centre]), np.zeros((FENCED.problem.horizon, 1))
    most = 0.0
    for _ in range(150):
        plan = supervisor.control(x, np.zeros(1), u, reference)
        supervisor.prepare(FENCED.problem.period)
        u = plan.input
        x = FENCED.a @ x + FENCED.b @ u + FENCED.offset
        most = max(most, x[0] - FENCE)
    assert most <= TOLERANCES.violation + 1e-9
    assert supervisor.reasons[REASONS[INFEASIBLE]] > 0  # it tried
    assert supervisor.layers["policy"] > 75


def test_a_simulation_that_runs_away_is_not_feasible(case):
    law, instance = exact_policy(case), next(instances(case, 1))
    everywhere = np.full(len(law.centre), np.inf)
    wide = dataclasses.replace(law.training_range, low=-everywhere, high=everywhere)
    policy = dataclasses.replace(law, training_range=wide)
    away = (np.full(policy.states, 1e200), *instance[1:])
    assert checked(case, policy, away, case.plan(np.zeros(case.size)) * 0.0) in (INFEASIBLE, OUT_OF_RANGE)


def test_a_policy_of_first_inputs_or_of_another_problem_is_refused(case):
    law, m = exact_policy(case), case.b.shape[1]
    first = dataclasses.replace(law, layers=(law.layers[0], tuple(part[:m] for part in law.layers[1])))
    with pytest.raises(UserError, match=f"1 of {case.problem.horizon} intervals"):
        supervisor_of(case, first)
    other = dataclasses.replace(case.problem, rate_weights=(2.0,) * m)
    with pytest.raises(UserError, match="another problem"):
        Supervisor(law, ExactMpc(case.system, other), TOLERANCES)
