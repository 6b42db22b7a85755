"""The approximate MPC: the network that it claims to be, and its bounds."""

import dataclasses

import numpy as np
import pytest
from small_policies import PROBLEM, by_hand, features_of, in_matrices, layers_of, model_of, policy_of, questions  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import Status
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.adaptation import Adaptation, Correction
from hybrid_sysid_ros.support.errors import UserError


def test_it_is_the_network_of_its_layers():
    policy = policy_of()
    for state, d, previous, preview in questions(50):
        expected = np.clip(by_hand(policy, features_of(state, d, previous, preview))[0], -10.0, 10.0)
        plan = policy.control(state, d, previous, preview)
        np.testing.assert_allclose(plan.input, expected, rtol=1e-12)
        assert plan.status is Status.POLICY


def test_it_answers_with_the_whole_plan_if_it_has_as_many_outputs():
    policy = policy_of(widths=(8, 16, 4))
    for state, d, previous, preview in questions(50):
        expected = np.clip(by_hand(policy, features_of(state, d, previous, preview))[0], -10.0, 10.0)
        plan = policy.control(state, d, previous, preview)
        np.testing.assert_allclose(plan.inputs[:, 0], expected, rtol=1e-12)
        assert plan.input[0] == plan.inputs[0, 0]


def test_no_plan_changes_faster_than_its_rate_limit():
    problem = dataclasses.replace(PROBLEM, rate_limit=0.7)
    policy = policy_of(widths=(8, 16, 4), problem=problem)
    for state, d, previous, preview in questions(50):
        plan = policy.control(state, d, previous, preview)
        before = np.clip(previous, -10.0, 10.0)
        assert np.max(np.abs(np.diff(plan.inputs[:, 0], prepend=before))) <= 0.7 + 1e-12
        assert np.max(np.abs(plan.inputs)) <= 10.0


def test_plans_don_t_change_once_they_are_given():
    policy = policy_of(widths=(8, 16, 4))
    first, second = (policy.control(*question) for question in questions(2))
    kept = first.inputs.copy()
    policy.control(*next(questions(1, seed=3)))
    np.testing.assert_array_equal(first.inputs, kept)
    assert np.any(first.inputs != second.inputs)


@pytest.mark.parametrize("part", range(4))
def test_a_question_of_another_size_is_refused_and_nothing_beyond_it_is_read(part):
    policy = policy_of()
    question = [*next(questions(1))]
    for other in (question[part][:-1], np.append(question[part], 0.0)):
        with pytest.raises(ValueError, match="size"):
            policy.control(*question[:part], other, *question[part + 1 :])


def test_any_kind_of_array_does():
    policy = policy_of()
    state, d, previous, preview = next(questions(1))
    expected = policy.control(state, d, previous, preview).input
    wide = np.zeros((4, 3))
    wide[:, 1] = preview
    preview32 = preview.astype(np.float32)
    np.testing.assert_array_equal(policy.control(state, d, previous, wide[:, 1]).input, expected)
    np.testing.assert_array_equal(policy.control(list(state), list(d), list(previous), list(preview)).input, expected)
    np.testing.assert_allclose(policy.control(state, d, previous, preview32).input, expected, rtol=1e-4)


# Parameters that are followed


def corrected(outputs):
    random = np.random.default_rng(9)
    return Correction(
        names=("gain", "coulomb"),
        nominal=np.array([5.0, 2.0]),
        spread=np.array([0.5, 0.4]),
        layers=layers_of(random, (8, 8, 2 * outputs)),
    )


@pytest.mark.parametrize("outputs", [1, 4])
def test_a_correction_is_linear_in_the_parameters(outputs):
    correction = corrected(outputs)
    policy = policy_of(widths=(8, 6, outputs), correction=correction)
    plain = policy_of(widths=(8, 6, outputs))
    gain, coulomb = 5.3, 1.9
    for question in questions(20):
        policy.adapt({"gain": 5.0, "coulomb": 2.0})
        np.testing.assert_array_equal(policy.control(*question).inputs, plain.control(*question).inputs)
        policy.adapt({"gain": gain, "coulomb": coulomb, "another": 3.0})
        features = features_of(*question)
        standard = (features - policy.centre) / policy.scale
        slopes = in_matrices(correction.layers, standard)[0].reshape(2, outputs)
        deviation = np.array([(gain - 5.0) / 0.5, (coulomb - 2.0) / 0.4])
        expected = by_hand(plain, features)[0] + 10.0 * deviation @ slopes
        np.testing.assert_allclose(policy.control(*question).inputs[:, 0], np.clip(expected, -10, 10), rtol=1e-9)


def test_a_parameter_that_is_no_number_or_far_off_leaves_the_policy_sane():
    policy = policy_of(widths=(8, 6, 4), correction=corrected(4))
    question = next(questions(1))
    policy.adapt({"gain": 5.2})
    expected = policy.control(*question).inputs
    policy.adapt({"gain": np.nan, "coulomb": np.inf})
    np.testing.assert_array_equal(policy.control(*question).inputs, expected)
    policy.adapt({"gain": 1e308})
    farthest = policy.control(*question).inputs
    policy.adapt({"gain": 6.0})  # two spreads
    np.testing.assert_array_equal(policy.control(*question).inputs, farthest)


def test_a_correction_survives_a_round_trip_and_must_fit(tmp_path):
    policy = policy_of(widths=(8, 6, 4), correction=corrected(4))
    policy.save(tmp_path / "policy")
    back = policies.load(tmp_path / "policy")
    question = next(questions(1))
    for each in (policy, back):
        each.adapt({"gain": 5.3, "coulomb": 2.2})
    np.testing.assert_array_equal(back.control(*question).inputs, policy.control(*question).inputs)
    with pytest.raises(UserError, match="correction has 2 outputs for 2 parameters"):
        policy_of(widths=(8, 6, 4), correction=corrected(1))


def test_a_parameter_to_follow_must_be_the_model_s():
    system = model_of().system
    assert Adaptation(names=("gain",), spread=(0.5,)).nominal(system) == [5.0]
    with pytest.raises(UserError, match="Linear has no parameter mass"):
        Adaptation(names=("mass",), spread=(1.0,)).nominal(system)
    with pytest.raises(UserError, match="spread above 0"):
        Adaptation(names=("gain",), spread=(0.0,))


# Bounds


def test_it_answers_errors_of_the_reference_and_not_where_the_beam_is():
    """Features are q - y: at the same error elsewhere only the position itself makes a difference."""
    policy = policy_of()
    blind = dataclasses.replace(
        policy, layers=((policy.layers[0][0] * (np.arange(8) > 0), policy.layers[0][1]), *policy.layers[1:])
    )
    state, d, previous, preview = next(questions(1))
    moved = blind.control(state + np.array([0.1, 0.0]), d, previous, preview + 0.1)
    np.testing.assert_allclose(moved.input, blind.control(state, d, previous, preview).input, rtol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e12])
@pytest.mark.parametrize("place", ["position", "velocity", "disturbance", "previous input", "preview"])
def test_the_input_is_finite_and_bounded_whatever_it_is_asked(place, value):
    policy = policy_of()
    for state, d, previous, preview in questions(5):
        target = {"position": state[:1], "velocity": state[1:], "disturbance": d, "previous input": previous}
        target.get(place, preview)[:1] = value
        plan = policy.control(state, d, previous, preview)
        assert np.isfinite(plan.input[0])
        assert abs(plan.input[0]) <= 10.0
        if not np.isfinite(value):
            # What is not a number says nothing: the input before, or none.
            assert plan.status is Status.HELD
            assert plan.input[0] == (np.clip(previous[0], -10, 10) if place != "previous input" else 0.0)


def test_an_input_held_is_within_its_bounds():
    state, d, _, preview = next(questions(1))
    plan = policy_of().control(state * np.nan, d, np.array([55.0]), preview)
    assert plan.input[0] == 10.0
