"""The approximate MPC: the network that it claims to be, and its bounds."""

import dataclasses

import numpy as np
import pytest
from small_policies import (  # type: ignore[import-not-found]
    PROBLEM,
    TWO,
    by_hand,
    correction_of,
    features_of,
    in_matrices,
    instances,
    policy_of,
)

from hybrid_sysid_ros.control import Status
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.support.errors import UserError


@pytest.fixture(params=[PROBLEM, TWO], ids=["one input", "two inputs"])
def problem(request):
    return request.param


def clipped(problem, inputs):
    return np.clip(inputs, problem.input_low, problem.input_high)


@pytest.mark.parametrize("hidden", [(5, 3), (16,), (32, 40, 7), (64, 96)])
@pytest.mark.parametrize("plan", [False, True], ids=["first inputs", "plan"])
def test_it_is_the_network_of_its_layers(problem, hidden, plan):
    policy = policy_of(problem=problem, hidden=hidden, plan=plan)
    for instance in instances(20, problem):
        expected = clipped(problem, by_hand(policy, features_of(policy, *instance))[0])
        found = policy.control(*instance)
        np.testing.assert_allclose(found.inputs, expected, rtol=1e-11, atol=1e-12)
        np.testing.assert_array_equal(found.input, found.inputs[0])
        assert found.status is Status.POLICY


def test_answers_to_features_are_those_to_instances(problem):
    policy = policy_of(problem=problem, plan=True)
    rows = [np.concatenate([np.ravel(part) for part in instance]) for instance in instances(30, problem)]
    answers = policy.evaluate(policy.features(np.array(rows)))
    found = [policy.control(*instance).inputs for instance in instances(30, problem)]
    np.testing.assert_allclose(clipped(problem, answers), found, rtol=1e-12)


def test_no_plan_changes_faster_than_its_rate_limits(problem):
    limits = (0.7, 0.1)[: len(problem.input_low)]
    policy = policy_of(problem=dataclasses.replace(problem, rate_limits=limits), plan=True)
    for state, d, previous, preview in instances(50, problem):
        inputs = policy.control(state, d, previous, preview).inputs
        before = clipped(problem, previous)
        assert np.all(np.abs(np.diff(inputs, axis=0, prepend=before[None])) <= np.array(limits) + 1e-12)
        np.testing.assert_array_equal(inputs, clipped(problem, inputs))


def test_plans_don_t_change_once_they_are_given():
    policy = policy_of(plan=True)
    first, second = (policy.control(*instance) for instance in instances(2))
    kept = first.inputs.copy()
    policy.control(*next(instances(1, seed=3)))
    np.testing.assert_array_equal(first.inputs, kept)
    assert np.any(first.inputs != second.inputs)


@pytest.mark.parametrize("part", range(4))
def test_an_instance_of_another_size_is_refused_and_nothing_beyond_it_is_read(problem, part):
    policy = policy_of(problem=problem)
    instance = [*next(instances(1, problem))]
    shape = instance[part].shape
    for size in (shape[0] - 1, shape[0] + 1):
        with pytest.raises(ValueError, match="size"):
            policy.control(*instance[:part], np.zeros((size, *shape[1:])), *instance[part + 1 :])


def test_any_kind_of_array_does(problem):
    policy = policy_of(problem=problem)
    state, d, previous, preview = next(instances(1, problem))
    expected = policy.control(state, d, previous, preview).input
    wide = np.zeros((len(preview), 7))
    wide[:, 1 : 1 + preview.shape[1]] = preview
    across = wide[:, 1 : 1 + preview.shape[1]]
    np.testing.assert_array_equal(policy.control(state, d, previous, across).input, expected)
    lists = (part.tolist() for part in (state, d, previous, preview))
    np.testing.assert_array_equal(policy.control(*lists).input, expected)
    found = policy.control(state, d, previous, preview.astype(np.float32)).input
    np.testing.assert_allclose(found, expected, rtol=1e-4)


# Parameters that are followed


@pytest.mark.parametrize("plan", [False, True], ids=["first inputs", "plan"])
def test_a_correction_is_linear_in_the_parameters(problem, plan):
    correction = correction_of(problem, plan=plan)
    policy, plain = (policy_of(problem=problem, plan=plan, correction=each) for each in (correction, None))
    gain, coulomb = 5.3, 1.9
    half = 0.5 * (np.array(problem.input_high) - np.array(problem.input_low))
    for instance in instances(20, problem):
        policy.adapt({"gain": 5.0, "coulomb": 2.0})
        np.testing.assert_array_equal(policy.control(*instance).inputs, plain.control(*instance).inputs)
        policy.adapt({"gain": gain, "coulomb": coulomb, "another": 3.0})
        features = features_of(policy, *instance)
        standard = (features - policy.centre) / policy.scale
        slopes = in_matrices(correction.layers, standard)[0].reshape(2, -1, len(half))
        moved = (gain - 5.0) / 0.5 * slopes[0] + (coulomb - 2.0) / 0.4 * slopes[1]
        expected = by_hand(plain, features)[0] + half * moved
        np.testing.assert_allclose(policy.control(*instance).inputs, clipped(problem, expected), rtol=1e-9, atol=1e-9)


def test_a_parameter_that_is_no_number_or_far_off_leaves_the_policy_sane():
    policy = policy_of(plan=True, correction=correction_of(PROBLEM))
    instance = next(instances(1))
    policy.adapt({"gain": 5.2})
    expected = policy.control(*instance).inputs
    policy.adapt({"gain": np.nan, "coulomb": np.inf})
    np.testing.assert_array_equal(policy.control(*instance).inputs, expected)
    policy.adapt({"gain": 1e308})
    farthest = policy.control(*instance).inputs
    policy.adapt({"gain": 6.0})  # two spreads
    np.testing.assert_array_equal(policy.control(*instance).inputs, farthest)


def test_a_correction_survives_a_round_trip_and_must_fit(tmp_path, problem):
    policy = policy_of(problem=problem, plan=True, correction=correction_of(problem))
    policy.save(tmp_path / "policy")
    back = policies.load(tmp_path / "policy")
    instance = next(instances(1, problem))
    for each in (policy, back):
        each.adapt({"gain": 5.3, "coulomb": 2.2})
    np.testing.assert_array_equal(back.control(*instance).inputs, policy.control(*instance).inputs)
    with pytest.raises(UserError, match="correction"):
        policy_of(problem=problem, plan=True, correction=correction_of(problem, plan=False))


def test_a_parameter_to_follow_needs_a_spread():
    with pytest.raises(UserError, match="spread"):
        Settings(followed={"gain": 0.0})


# Bounds


def test_it_answers_errors_of_the_references_and_not_where_the_plant_is(problem):
    """Features are q - C x: at the same error elsewhere only the states themselves make a difference."""
    policy = policy_of(problem=problem)
    (matrix, bias), *others = policy.layers
    blind = dataclasses.replace(
        policy, layers=((matrix * (np.arange(matrix.shape[1]) >= policy.states), bias), *others)
    )
    state, d, previous, preview = next(instances(1, problem))
    move = 0.1 * np.arange(1, policy.states + 1)
    there = preview.copy()
    there[:, list(policy.tracked)] += policy.output_map @ move
    found = blind.control(state + move, d, previous, there).input
    np.testing.assert_allclose(found, blind.control(state, d, previous, preview).input, rtol=1e-12)


def test_what_an_untracked_output_should_be_is_not_read():
    policy = policy_of(problem=TWO)
    state, d, previous, preview = next(instances(1, TWO))
    expected = policy.control(state, d, previous, preview).input
    preview[:, 1] = np.nan
    np.testing.assert_array_equal(policy.control(state, d, previous, preview).input, expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e12])
@pytest.mark.parametrize("part", range(4), ids=["state", "disturbance", "previous input", "preview"])
def test_the_inputs_are_finite_and_bounded_whatever_it_is_asked(problem, part, value):
    policy = policy_of(problem=problem)
    for instance in instances(5, problem):
        instance[part].flat[0] = value
        plan = policy.control(*instance)
        assert np.all(np.isfinite(plan.inputs))
        np.testing.assert_array_equal(plan.inputs, clipped(problem, plan.inputs))
        if not np.isfinite(value):
            # What is not a number says nothing: the input before, or none.
            assert plan.status is Status.HELD
            before = np.where(np.isfinite(instance[2]), instance[2], 0.0)
            np.testing.assert_array_equal(plan.input, clipped(problem, before))


def test_an_input_held_is_within_its_bounds():
    state, d, _, preview = next(instances(1, TWO))
    plan = policy_of(problem=TWO).control(state * np.nan, d, np.array([55.0, -1.0]), preview)
    np.testing.assert_array_equal(plan.input, [10.0, 0.0])
