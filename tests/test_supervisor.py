"""The supervisor: the check against a cost worked out by hand, layers that take over without a jump, inputs that are
always sane.
"""

import dataclasses
import math
from itertools import count

import numba
import numpy as np
import pytest
from linear_policies import (  # type: ignore[import-not-found]
    BROKEN_BY,
    LINEAR,
    PROBLEM,
    broken_policy,
    exact_policy,
    plan_by_hand,
)
from small_policies import policy_of  # type: ignore[import-not-found]
from test_mpc import ABSURD, least_squares_form  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.safety.online_check import (
    ACCEPTED,
    COSTLIER,
    DISTURBED,
    INFEASIBLE,
    OUT_OF_RANGE,
    REASONS,
    WAITING,
    Tolerances,
    online_check,
    trial,
)
from hybrid_sysid_ros.control.safety.supervisor import LAYERS, Supervisor
from hybrid_sysid_ros.support.errors import UserError

TOLERANCES = Tolerances(cost=0.05, floor=0.5, violation=1e-4, disturbance=1.0, patience=3)


def questions(number, seed=0):
    """Questions near rest, the disturbance below zero: there the broken policy is sound."""
    random = np.random.default_rng(seed)
    for _ in range(number):
        state, preview = random.normal(size=2) * [0.02, 0.1], 0.02 * random.normal(size=PROBLEM.horizon)
        yield state, -0.5 * random.uniform(size=1), 3 * random.normal(size=1), preview


def flat(question):
    return np.concatenate(question)


def supervisor_of(policy, tolerances=TOLERANCES, **options):
    return Supervisor(policy, ExactMpc(LINEAR, policy.problem, **options), tolerances)


@pytest.fixture(scope="module")
def law():
    return exact_policy()


@pytest.fixture(scope="module")
def broken():
    return broken_policy()


def checked(policy, question, last_plan, tolerances=TOLERANCES):
    """What a single check finds."""
    shooting = ExactMpc(LINEAR, policy.problem).shooting
    shooting.horizon.inputs[:] = last_plan
    memory, reach = policy.memory, policy.training_range.packed
    check = online_check(LINEAR, policy).check
    return check(flat(question), memory, reach, shooting.model, shooting.horizon, tolerances, trial(policy))


# The check


def test_the_cost_of_a_plan_is_that_of_the_problem(law):
    """By hand it is the sum of squares whose minimum is the optimum."""
    shooting = ExactMpc(LINEAR, PROBLEM).shooting
    follow = numba.njit(online_check(LINEAR, law).follow)
    for question in questions(20):
        inputs = 5 * np.random.default_rng(1).normal(size=PROBLEM.horizon)
        cost, outside = follow(flat(question), shooting.model, shooting.horizon, inputs, np.empty((9, 2)))
        matrix, right = least_squares_form(PROBLEM, question[0], question[1][0], question[2][0], question[3])
        assert cost == pytest.approx(np.sum((matrix @ inputs - right) ** 2), rel=1e-9)
        assert outside == 0.0


def test_a_plan_as_good_as_the_last_one_is_accepted_and_a_costlier_one_is_not(law, broken):
    for question in questions(10):
        best = plan_by_hand(flat(question))
        assert checked(law, question, best) == ACCEPTED
        assert checked(broken, question, best) == ACCEPTED  # sound below zero
        disturbed = (question[0], -question[1], *question[2:])
        best = plan_by_hand(flat(disturbed))
        assert checked(law, disturbed, best) == ACCEPTED
        assert checked(broken, disturbed, best) == COSTLIER
        assert checked(broken, disturbed, best + 2 * BROKEN_BY) == ACCEPTED  # better than that it is


def test_the_tolerance_is_a_share_and_a_floor(law):
    """Beside a last plan whose cost is known, the network's is accepted up to exactly that cost."""
    question = next(questions(1))
    matrix, right = least_squares_form(PROBLEM, question[0], question[1][0], question[2][0], question[3])
    best = plan_by_hand(flat(question))
    cost = np.sum((matrix @ best - right) ** 2)
    worse = policy_shifted(law, 0.3)
    costlier = np.sum((matrix @ (best + 0.3) - right) ** 2)
    for share, floor in ((0.0, costlier - cost), (costlier / cost - 1.0, 0.0)):
        just, short = (TOLERANCES._replace(cost=share * k, floor=floor * k) for k in (1.001, 0.999))
        assert checked(worse, question, best, just) == ACCEPTED
        assert checked(worse, question, best, short) == COSTLIER


def policy_shifted(policy, volts):
    """The same law, all of its inputs so much higher."""
    hidden, (matrix, bias) = policy.layers
    return dataclasses.replace(policy, layers=(hidden, (matrix, bias + volts / policy.problem.input_limit)))


def test_it_tells_why(law):
    question = next(questions(1))
    best = plan_by_hand(flat(question))
    state, d, previous, preview = question
    assert checked(law, (state, np.array([-1.5]), previous, preview), best) == DISTURBED
    assert checked(law, (state + 2e3, d, previous, preview), best) == OUT_OF_RANGE
    assert checked(law, (state * np.nan, d, previous, preview), best) == OUT_OF_RANGE
    assert checked(law, (state, d * np.nan, previous, preview), best) == OUT_OF_RANGE


def test_a_state_out_of_its_bounds_is_not_feasible_unless_the_last_plan_is_as_far_out():
    problem = dataclasses.replace(PROBLEM, state_bounds=((-0.01, 0.01), (-1e3, 1e3)), soft_quadratic=1e-3)
    policy = exact_policy(problem)
    rest = np.zeros(2), np.zeros(1), np.array([LINEAR.centre])
    far = np.full(problem.horizon, 0.05)
    towards = plan_by_hand(flat((*rest, far)))
    assert checked(policy, (*rest, far), np.full(problem.horizon, LINEAR.centre)) == INFEASIBLE
    assert checked(policy, (*rest, far), towards) == ACCEPTED


def test_a_simulation_that_runs_away_is_not_feasible(law):
    _, d, previous, preview = next(questions(1))
    wide = dataclasses.replace(
        law.training_range, low=np.full(len(law.centre), -np.inf), high=np.full(len(law.centre), np.inf)
    )
    policy = dataclasses.replace(law, training_range=wide)
    assert checked(policy, (np.array([1e200, 0.0]), d, previous, preview), np.zeros(8)) in (INFEASIBLE, OUT_OF_RANGE)


def test_a_policy_of_first_inputs_or_of_another_problem_is_refused(law):
    first = dataclasses.replace(law, layers=(law.layers[0], tuple(part[:1] for part in law.layers[1])))
    with pytest.raises(UserError, match="gives 1 of the 8 inputs of a plan"):
        supervisor_of(first)
    with pytest.raises(UserError, match="another problem"):
        Supervisor(law, ExactMpc(LINEAR, dataclasses.replace(PROBLEM, rate_weight=2.0)), TOLERANCES)


# Layers


def test_the_first_plan_is_the_exact_one_s_and_then_the_network_drives(law):
    supervisor = supervisor_of(law)
    statuses = []
    for question in questions(5):
        plan = supervisor.control(*question)
        np.testing.assert_allclose(plan.inputs[:, 0], plan_by_hand(flat(question)), atol=1e-4)
        assert plan.states.shape == (PROBLEM.horizon, 2)
        statuses.append(plan.status)
        supervisor.prepare(PROBLEM.period)
    assert statuses == [Status.SOLVED, *[Status.POLICY] * 4]
    assert supervisor.layers == {"exact": 1, "policy": 4}
    assert supervisor.reasons == {REASONS[WAITING]: 1, REASONS[ACCEPTED]: 4}


def test_a_rejected_network_drives_again_after_some_good_answers(broken):
    """One bad answer, then three good ones that are not used, then it drives."""
    supervisor = supervisor_of(broken)
    sound = list(questions(8))
    layers = []
    for k, question in enumerate(sound):
        bad = (question[0], np.array([0.5]), *question[2:])
        layers.append(LAYERS[supervisor.control(*(bad if k == 2 else question)).status])
        supervisor.prepare(PROBLEM.period)
    assert layers == ["exact", "policy", *["exact"] * 4, "policy", "policy"]
    assert supervisor.reasons[REASONS[WAITING]] == 1 + 3
    assert supervisor.reasons[REASONS[COSTLIER]] == 1


def test_every_layer_answers_as_it_would_alone(broken):
    """So a change of layer can't make a jump that neither of them would make."""
    supervisor = supervisor_of(broken)
    random = np.random.default_rng(0)
    changes, before = 0, None
    for question in questions(60, seed=4):
        asked = (question[0], np.array([0.5 if random.uniform() < 0.2 else -0.5]), *question[2:])
        plan = supervisor.control(*asked)
        if plan.status is Status.POLICY:
            np.testing.assert_array_equal(plan.inputs, broken.control(*asked).inputs)
        else:
            np.testing.assert_allclose(plan.inputs[:, 0], plan_by_hand(flat(asked)), atol=1e-6)
        changes += before is not None and LAYERS[before] != LAYERS[plan.status]
        before = plan.status
        supervisor.prepare(PROBLEM.period)
    assert changes > 5


def test_where_the_exact_mpc_is_late_the_rest_of_the_last_plan_stands_in_whoever_made_it(broken):
    supervisor = supervisor_of(broken)
    sound = list(questions(2))
    supervisor.control(*sound[0])
    supervisor.prepare(PROBLEM.period)
    applied = supervisor.control(*sound[1])
    assert applied.status is Status.POLICY
    supervisor.prepare(PROBLEM.period)
    hasty = ExactMpc(LINEAR, PROBLEM, tolerance=0.0, time_limit=0.5, clock=count().__next__)
    hasty.adopt(np.zeros(1), applied.inputs[:, 0], np.zeros((9, 2)))
    hasty.prepare(PROBLEM.period)
    supervisor.mpc = hasty
    late = supervisor.control(sound[1][0], np.array([0.5]), applied.input, sound[1][3])
    assert late.status is Status.LATE
    np.testing.assert_allclose(late.inputs[:-1, 0], applied.inputs[1:, 0], rtol=1e-12)
    assert supervisor.layers["shifted plan"] == 1


def test_without_numbers_it_goes_on_with_the_last_plan_until_that_is_used_up_and_then_holds(law):
    supervisor = supervisor_of(law)
    question = next(questions(1))
    nothing = (question[0] * np.nan, *question[1:2], np.zeros(1), question[3])
    held = supervisor.control(nothing[0], nothing[1], np.array([123.0]), nothing[3])
    assert held.status is Status.HELD
    assert held.input[0] == PROBLEM.input_limit
    first = supervisor.control(*question)
    given, statuses = [], []
    u = first.input
    for _ in range(10):
        supervisor.prepare(PROBLEM.period)
        plan = supervisor.control(nothing[0], nothing[1], u, nothing[3])
        u = plan.input
        given.append(u[0])
        statuses.append(LAYERS[plan.status])
    assert statuses == [*["shifted plan"] * 7, *["held"] * 3]
    np.testing.assert_allclose(given[:7], first.inputs[1:, 0], rtol=1e-12)
    np.testing.assert_allclose(given[7:], given[6])


def test_it_forgets_on_a_reset(law):
    supervisor = supervisor_of(law)
    question = next(questions(1))
    supervisor.control(*question)
    supervisor.reset()
    held = supervisor.control(question[0] * np.nan, question[1], np.array([2.0]), question[3])
    assert (held.status, held.input[0]) == (Status.HELD, 2.0)


@pytest.mark.parametrize("real_time", [False, True], ids=["converged", "real time"])
def test_in_real_time_it_answers_with_one_iteration(broken, real_time):
    supervisor = supervisor_of(broken, real_time=real_time)
    statuses = []
    for question in questions(6):
        bad = (question[0], np.array([0.5]), *question[2:])
        statuses.append(supervisor.control(*bad).status)
        supervisor.prepare(PROBLEM.period)
    assert statuses == [Status.SOLVED, *[Status.ITERATED if real_time else Status.SOLVED] * 5]


def test_every_status_has_a_layer():
    assert set(LAYERS) == set(Status)


# Sanity


def test_an_absurd_question_after_sane_ones_does_not_keep_the_exact_mpc_for_ever(law):
    """Steps that teach the Hessian nonsense, programs without a solution, and the same steps again."""
    mpc = ExactMpc(LINEAR, PROBLEM)
    state, d, previous, preview = next(questions(1))
    for value in (1e6, 1e9, 1e12, 1e15, 1e100):
        mpc.reset()
        mpc.control(state, d, previous, preview)
        plan = mpc.control(np.array([value, 0.5]), d, previous, preview)
        assert abs(plan.input[0]) <= PROBLEM.input_limit


@pytest.mark.parametrize("rate_limit", [math.inf, 0.8])
def test_the_input_is_finite_and_bounded_whatever_arrives(rate_limit):
    """Random networks, limits that bind, absurd numbers in any place, at any time."""
    random = np.random.default_rng(7)
    base = policy_of(widths=(8, 8, 4))
    problem = dataclasses.replace(base.problem, rate_limit=rate_limit)
    seen = set()
    mpc = ExactMpc(LINEAR, problem)
    for seed in range(20):
        policy = dataclasses.replace(policy_of(seed=seed, widths=(8, 8, 4)), problem=problem)
        supervisor = Supervisor(policy, mpc, TOLERANCES._replace(floor=1e6 * (seed % 2), disturbance=100.0))
        supervisor.reset()
        u = np.array([random.uniform(-10.0, 10.0)])
        for _ in range(20):
            question = np.concatenate(
                [random.normal(size=2) * [0.05, 0.3], random.normal(size=1), u, 0.08 * random.normal(size=4)]
            )
            if random.uniform() < 0.3:
                question[random.integers(8)] = random.choice(ABSURD)
            plan = supervisor.control(question[:2], question[2:3], question[3:4], question[4:])
            assert np.all(np.isfinite(plan.inputs))
            assert np.all(np.abs(plan.inputs) <= 10.0)
            assert np.isfinite(plan.input[0])
            assert abs(plan.input[0]) <= 10.0
            before = np.clip(question[3], -10.0, 10.0) if np.isfinite(question[3]) else plan.input[0]
            assert abs(plan.input[0] - before) <= rate_limit + 1e-6
            u = plan.input.copy()
            seen.add(LAYERS[plan.status])
            supervisor.prepare(random.choice([problem.period, 0.3 * problem.period]))
    assert seen == {"policy", "exact", "shifted plan", "held"}
    assert sum(supervisor.layers.values()) == sum(supervisor.reasons.values()) == 20
