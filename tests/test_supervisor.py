"""The supervisor: the check against a cost worked out by hand, layers that take over without a jump, inputs that are
always sane.
"""

import dataclasses
import math
from itertools import count

import numpy as np
import pytest
from linear_policies import BEAM, BROKEN_BY, CASES, SMALL, broken_policy, exact_policy  # type: ignore[import-not-found]
from small_policies import PROBLEM, TWO, policy_of  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.shooting import rollout
from hybrid_sysid_ros.control.safety.supervision import (
    ACCEPTED,
    COSTLIER,
    DISTURBED,
    IMPROVED,
    INFEASIBLE,
    OUT_OF_RANGE,
    WAITING,
)
from hybrid_sysid_ros.control.safety.supervisor import LAYERS, REASONS, Supervisor, Tolerances
from hybrid_sysid_ros.support.errors import UserError

ABSURD = [1e3, -1e6, 1e12, 1e300, np.inf, -np.inf, np.nan]
TOLERANCES = Tolerances(cost=0.05, floor=0.5, violation=1e-4, disturbance=(1.0,), patience=3)
FENCE = 0.01
LIMITS = {"state_low": (-FENCE, -1e3), "state_high": (FENCE, 1e3), "soft_quadratic": (1e-3,) * 2}
FENCED = dataclasses.replace(BEAM, problem=dataclasses.replace(BEAM.problem, **LIMITS))
"""The beam with bounds of its position that cost next to nothing, so the exact law is still linear."""


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]


def instances(case, number, seed=0):
    """Near rest, the disturbances below zero: there the broken policy is sound."""
    random = np.random.default_rng(seed)
    (p, n), m = case.c.shape, case.b.shape[1]
    scale = 0.02 * np.repeat([1.0, 5.0], n // 2)
    for _ in range(number):
        preview = 0.02 * random.normal(size=(case.problem.horizon, p))
        yield random.normal(size=n) * scale, -0.5 * random.uniform(size=m), 3 * random.normal(size=m), preview


def flat(instance):
    return np.concatenate([np.ravel(part) for part in instance])


def bad(instance):
    """The same, but with the disturbance under which the broken policy is broken."""
    return (instance[0], np.append(0.5, instance[1][1:]), *instance[2:])


def supervisor_of(case, policy, tolerances=TOLERANCES, **options):
    return Supervisor(policy, ExactMpc(case.system, policy.problem, **options), tolerances)


def checked(case, policy, instance, last_plan, tolerances=TOLERANCES):
    """What a single check finds."""
    mpc = ExactMpc(case.system, policy.problem)
    supervisor, horizon = Supervisor(policy, mpc, tolerances), mpc.shooting.horizon
    mpc.adopt(np.zeros(policy.inputs), np.reshape(last_plan, horizon.inputs.shape), np.zeros_like(horizon.states))
    supervisor.control(*instance)
    return supervisor.reason


# The check


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


def policy_shifted(policy, units):
    """The same law, all of its inputs so much higher."""
    hidden, (matrix, bias) = policy.layers
    half = 0.5 * (np.array(policy.problem.input_high) - np.array(policy.problem.input_low))
    return dataclasses.replace(policy, layers=(hidden, (matrix, bias + units / np.tile(half, policy.horizon))))


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


# Layers


def test_the_first_plan_is_the_exact_one_s_and_then_the_network_drives(case):
    supervisor = supervisor_of(case, exact_policy(case))
    statuses = []
    for instance in instances(case, 5):
        plan = supervisor.control(*instance)
        np.testing.assert_allclose(plan.inputs, case.plan(flat(instance)), atol=1e-4)
        assert plan.states.shape == (case.problem.horizon, len(case.a))
        statuses.append(plan.status)
        supervisor.prepare(case.problem.period)
    assert statuses == [Status.SOLVED, *[Status.POLICY] * 4]
    assert supervisor.layers == {"exact": 1, "policy": 4}
    assert supervisor.reasons == {REASONS[WAITING]: 1, REASONS[ACCEPTED]: 4}


def test_a_network_drives_where_the_last_plan_a_step_from_it_and_its_own_plan_agree(case):
    """However generous the costs are. The problem is linear, so a step from any plan is the solution."""
    generous = TOLERANCES._replace(floor=1e9, patience=0)
    first, other = instances(case, 2)
    for asked, step, reason in (
        ([first, first], 0.05, ACCEPTED),
        ([bad(first), bad(first)], math.inf, ACCEPTED),
        ([bad(first), bad(first)], 0.05, IMPROVED),
        ([first, other], 0.05, IMPROVED),
        ([first, other], math.inf, ACCEPTED),
    ):
        law = broken_policy(case)
        supervisor = Supervisor(law, ExactMpc(case.system, case.problem), generous._replace(step=(step,)))
        supervisor.control(*asked[0])
        plan = supervisor.control(*asked[1])
        assert supervisor.reason == reason
        expected = law.control(*asked[1]).inputs if reason == ACCEPTED else case.plan(flat(asked[1]))
        np.testing.assert_allclose(plan.inputs, expected, atol=1e-5)


@pytest.mark.parametrize("stage", [0, -1], ids=["first", "last"])
def test_no_network_is_believed_where_a_step_moves_any_input_of_the_last_plan(case, stage):
    """Not even the exact law: where the last plan is off later on only, it may be on its way to another solution."""
    generous, instance = TOLERANCES._replace(floor=1e9, patience=0, step=(0.05,)), next(instances(case, 1))
    for off, reason in ((0.04, ACCEPTED), (0.06, IMPROVED)):
        last = case.plan(flat(instance))
        last[stage, 0] += off
        assert checked(case, exact_policy(case), instance, last, generous) == reason


def test_a_plan_may_cost_a_part_of_a_sample_s_noise_more_than_the_step(case):
    """However much more it may cost than the shifted plan: here it is accepted up to exactly that cost."""
    instance = next(instances(case, 1))
    matrix, right = case.least_squares(flat(instance))
    best = case.plan(flat(instance))
    more = np.sum((matrix @ (best.ravel() + 0.03) - right) ** 2) - np.sum((matrix @ best.ravel() - right) ** 2)
    samples = case.problem.horizon / 0.1
    for share, reason in ((1.001, ACCEPTED), (0.999, IMPROVED)):
        given = TOLERANCES._replace(cost=1e9, floor=share * samples * more, patience=0, step=(0.05,), noise=0.1)
        assert checked(case, policy_shifted(exact_policy(case), 0.03), instance, best, given) == reason


@pytest.mark.parametrize("real_time", [False, True], ids=["converged", "real time"])
def test_while_a_network_drives_the_exact_mpc_follows(case, real_time):
    """What it takes over with is its own plan, not the network's, which is off by less than is allowed."""
    law, instance = broken_policy(case), bad(next(instances(case, 1)))
    generous = TOLERANCES._replace(floor=1e9, patience=0, step=(2.0 * BROKEN_BY,))
    supervisor = Supervisor(law, ExactMpc(case.system, case.problem, real_time=real_time), generous)
    alone, followed = ExactMpc(case.system, case.problem, real_time=real_time), supervisor.mpc.shooting.horizon
    for status in (Status.SOLVED, Status.POLICY, Status.POLICY):
        assert supervisor.control(*instance).status is status
        alone.control(*instance)
        for each in (supervisor, alone):
            each.prepare(0.5 * case.problem.period)
        np.testing.assert_allclose(followed.inputs, alone.shooting.horizon.inputs, atol=1e-6)


def test_answers_count_as_good_that_are_near_those_of_the_exact_mpc_beside_them(case):
    asked, step = next(instances(case, 1)), 0.05
    supervisor = supervisor_of(case, broken_policy(case), TOLERANCES._replace(floor=1e9, patience=2, step=(step,)))
    seen = []
    for off in (False, False, False, False, True, True, False, False, False):
        supervisor.control(*(bad(asked) if off else asked))
        seen.append(supervisor.reason)
    assert seen == [*[WAITING] * 3, ACCEPTED, IMPROVED, *[WAITING] * 3, ACCEPTED]


def test_a_rejected_network_drives_again_after_some_good_answers(case):
    """One bad answer, then three good ones that are not used, then it drives."""
    supervisor = supervisor_of(case, broken_policy(case))
    layers = []
    for k, instance in enumerate(instances(case, 8)):
        layers.append(LAYERS[supervisor.control(*(bad(instance) if k == 2 else instance)).status])
        supervisor.prepare(case.problem.period)
    assert layers == ["exact", "policy", *["exact"] * 4, "policy", "policy"]
    assert supervisor.reasons[REASONS[WAITING]] == 1 + 3
    assert supervisor.reasons[REASONS[COSTLIER]] == 1


def test_every_layer_answers_as_it_would_alone(case):
    """So a change of layer can't make a jump that neither of them would make."""
    broken = broken_policy(case)
    supervisor = supervisor_of(case, broken)
    random = np.random.default_rng(0)
    changes, before = 0, None
    for instance in instances(case, 60, seed=4):
        asked = bad(instance) if random.uniform() < 0.2 else instance
        plan = supervisor.control(*asked)
        if plan.status is Status.POLICY:
            np.testing.assert_array_equal(plan.inputs, broken.control(*asked).inputs)
        else:
            np.testing.assert_allclose(plan.inputs, case.plan(flat(asked)), atol=1e-5)
        changes += before is not None and LAYERS[before] != LAYERS[plan.status]
        before = plan.status
        supervisor.prepare(case.problem.period)
    assert changes > 5


def test_where_the_exact_mpc_is_late_the_rest_of_the_last_plan_stands_in_whoever_made_it(case):
    supervisor = supervisor_of(case, broken_policy(case))
    sound = list(instances(case, 2))
    supervisor.control(*sound[0])
    supervisor.prepare(case.problem.period)
    applied = supervisor.control(*sound[1])
    assert applied.status is Status.POLICY
    supervisor.prepare(case.problem.period)
    hasty = ExactMpc(case.system, case.problem, tolerance=0.0, time_limit=0.5, clock=count().__next__)
    hasty.adopt(np.zeros(case.b.shape[1]), applied.inputs, np.zeros((case.problem.horizon + 1, len(case.a))))
    hasty.prepare(case.problem.period)
    late = Supervisor(broken_policy(case), hasty, TOLERANCES)
    hasty.adopt(np.zeros(case.b.shape[1]), applied.inputs, np.zeros((case.problem.horizon + 1, len(case.a))))
    hasty.prepare(case.problem.period)
    state, d, _, preview = bad(sound[1])
    plan = late.control(state, d, applied.input, preview)
    assert plan.status is Status.LATE
    np.testing.assert_allclose(plan.inputs[:-1], applied.inputs[1:], rtol=1e-12)
    assert late.layers["shifted plan"] == 1


def test_without_numbers_it_goes_on_with_the_last_plan_until_that_is_used_up_and_then_holds(case):
    supervisor, horizon = supervisor_of(case, exact_policy(case)), case.problem.horizon
    state, d, previous, preview = next(instances(case, 1))
    held = supervisor.control(state * np.nan, d, np.full(len(d), 1e9), preview)
    assert held.status is Status.HELD
    np.testing.assert_array_equal(held.input, case.problem.input_high)
    first = supervisor.control(state, d, previous, preview)
    given, statuses = [], []
    u = first.input
    for _ in range(horizon + 2):
        supervisor.prepare(case.problem.period)
        plan = supervisor.control(state * np.nan, d, u, preview)
        u = plan.input
        given.append(u)
        statuses.append(LAYERS[plan.status])
    assert statuses == [*["shifted plan"] * (horizon - 1), *["held"] * 3]
    np.testing.assert_allclose(given[: horizon - 1], first.inputs[1:], rtol=1e-12)
    np.testing.assert_allclose(given[horizon - 1 :], [given[horizon - 2]] * 3)


def test_it_forgets_on_a_reset(case):
    supervisor = supervisor_of(case, exact_policy(case))
    state, d, previous, preview = next(instances(case, 1))
    supervisor.control(state, d, previous, preview)
    supervisor.reset()
    held = supervisor.control(state * np.nan, d, np.full(len(d), 2.0), preview)
    assert held.status is Status.HELD
    np.testing.assert_array_equal(held.input, 2.0)


@pytest.mark.parametrize("real_time", [False, True], ids=["converged", "real time"])
def test_in_real_time_it_answers_with_one_iteration(case, real_time):
    supervisor = supervisor_of(case, broken_policy(case), real_time=real_time)
    statuses = []
    for instance in instances(case, 6):
        statuses.append(supervisor.control(*bad(instance)).status)
        supervisor.prepare(case.problem.period)
    assert statuses == [Status.SOLVED, *[Status.ITERATED if real_time else Status.SOLVED] * 5]


def test_every_status_has_a_layer():
    assert set(LAYERS) == set(Status)


# Sanity


@pytest.mark.parametrize("name", CASES)
def test_the_inputs_are_finite_and_bounded_whatever_arrives(name):
    """Random networks, limits that bind, absurd numbers in any place, at any time."""
    seen: set[str] = set()
    for limit in (math.inf, 0.8):
        problem = dataclasses.replace(
            PROBLEM if name == "beam" else TWO, rate_limits=(limit,) * CASES[name].b.shape[1], smoothing=0.005
        )
        mpc, random = ExactMpc(CASES[name].system, problem), np.random.default_rng(7)
        for seed in range(20):
            policy = policy_of(seed=seed, hidden=(8, 8), problem=problem, plan=True)
            tolerances = TOLERANCES._replace(floor=1e6 * (seed % 2), disturbance=(100.0,))
            seen |= thrown_at(Supervisor(policy, mpc, tolerances), random, blind=seed % 4 == 0)
    assert seen == {"policy", "exact", "shifted plan", "held"}


def thrown_at(supervisor, random, *, blind):
    """Which layers answered to random numbers, each answer within its bounds; blind: it begins without a state."""
    policy, problem = supervisor.policy, supervisor.policy.problem
    low, high = np.array(problem.input_low), np.array(problem.input_high)
    u, seen = random.uniform(low, high), set()
    for k in range(20):
        asked = [0.05 * random.normal(size=policy.states), 0.5 * random.normal(size=len(low)), u.copy()]
        asked.append(0.05 * random.normal(size=(problem.horizon, policy.outputs)))
        if blind and k == 0:
            asked[0] = asked[0] * np.nan
        if random.uniform() < 0.3:
            part = asked[random.integers(4)]
            part.flat[random.integers(part.size)] = random.choice(ABSURD)
        plan = supervisor.control(*asked)
        assert np.all(np.isfinite(plan.inputs))
        assert np.all((low <= plan.inputs) & (plan.inputs <= high))
        assert np.all((low <= plan.input) & (plan.input <= high))
        before = np.where(np.isfinite(asked[2]), np.clip(asked[2], low, high), plan.input)
        assert np.all(np.abs(plan.input - before) <= np.array(problem.rate_limits) + 1e-6)
        u = plan.input.copy()
        seen.add(LAYERS[plan.status])
        supervisor.prepare(random.choice([problem.period, 0.3 * problem.period]))
    return seen
