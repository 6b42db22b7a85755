"""The supervisor: the check against a cost worked out by hand, layers that take over without a jump, inputs that are
always sane.
"""

import dataclasses
import math
from itertools import count

import numpy as np
import pytest
from linear_policies import BROKEN_BY, CASES, broken_policy, exact_policy  # type: ignore[import-not-found]
from small_policies import PROBLEM, TWO, policy_of  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.safety.supervision import (
    ACCEPTED,
    COSTLIER,
    IMPROVED,
    WAITING,
)
from hybrid_sysid_ros.control.safety.supervisor import LAYERS, REASONS, Supervisor
from hybrid_sysid_ros.support.errors import UserError
from tests.supervised import TOLERANCES, bad, checked, flat, instances, policy_shifted, supervisor_of

ABSURD = [1e3, -1e6, 1e12, 1e300, np.inf, -np.inf, np.nan]


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]


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


def test_in_real_time_a_period_has_one_step_whoever_answers(case):
    """Where the network is rejected, the answer is that of the exact MPC alone, in real time, too."""
    generous = TOLERANCES._replace(floor=1e9, patience=1, step=(0.05,))
    supervisor = Supervisor(broken_policy(case), ExactMpc(case.system, case.problem, real_time=True), generous)
    alone, asked, statuses = ExactMpc(case.system, case.problem, real_time=True), next(instances(case, 1)), []
    for off in (False, False, False, True, True, True, False, False, False):
        plan, own = (each.control(*(bad(asked) if off else asked)) for each in (supervisor, alone))
        statuses.append(plan.status)
        if plan.status is not Status.POLICY:
            assert plan.status is own.status
            np.testing.assert_allclose(plan.inputs, own.inputs, atol=1e-9)
        np.testing.assert_allclose(supervisor.mpc.shooting.horizon.inputs, alone.shooting.horizon.inputs, atol=1e-9)
        supervisor.prepare(0.0)
        alone.prepare(0.0)
    rejected = [Status.ITERATED] * 5
    assert statuses == [Status.SOLVED, Status.ITERATED, Status.POLICY, *rejected, Status.POLICY]


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


def test_it_takes_no_exact_mpc_whose_steps_are_not_checked(case):
    mpc = ExactMpc(case.system, case.problem, real_time=True, checked=False)
    with pytest.raises(UserError, match="checked=True"):
        Supervisor(broken_policy(case), mpc, TOLERANCES)


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
