"""A training: what it learns, what it tells about itself, and that a seed decides it."""

import dataclasses
import os

import numpy as np
import pytest
from hybrid_sysid_ros.control.policy.sample_store import SampleStore
from hybrid_sysid_ros.control.policy.sampling import Samples, sample
from small_policies import PROBLEM, SEAL, SPREAD, by_hand, model_of  # type: ignore[import-not-found]
from test_sampling import some_samples  # type: ignore[import-not-found]

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.adaptation import Adaptation
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.support.errors import UserError


def nothing_solved():
    none = {name: getattr(some_samples(0), name)[:0] for name in Samples.__dataclass_fields__ if name != "dropped"}
    return Samples(**none, dropped=160)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A tiny training: a linear beam, nine closed loops in two rounds; twice, by different ways to the same samples."""
    training = pytest.importorskip("hybrid_sysid_ros.control.policy.training", exc_type=ImportError)
    settings = Settings(episodes=(6, 3), hidden=(16,), epochs=60, batch=128, workers=min(2, os.cpu_count() or 1))
    model = model_of(SEAL)
    store = SampleStore(tmp_path_factory.mktemp("store") / "samples", "tiny")
    first = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    again = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    return first, again


def test_a_tiny_training_imitates_better_than_a_constant(trained):
    policy, _ = trained
    fresh = sample(model_of().system, PROBLEM, SPREAD, 424242)
    rows = zip(fresh.states, fresh.disturbances, fresh.previous, fresh.previews, strict=True)
    answers = [policy.control(x, np.array([d]), np.array([u]), q).input[0] for x, d, u, q in rows]
    assert np.mean((np.array(answers) - fresh.inputs[:, 0]) ** 2) < 0.3 * np.var(fresh.inputs[:, 0])


def test_a_training_tells_how_it_was_made(trained):
    record = trained[0].training
    assert record["rounds"] == [6, 3]
    assert record["samples"] + record["validation_samples"] + record["dropped"] == 9 * 160
    assert 0 < record["train_mse"] < 100
    assert record["validation_mse"] > 0
    assert trained[0].model == SEAL


def test_a_seed_decides_a_training(trained):
    first, again = trained
    for (w, b), (w_again, b_again) in zip(first.layers, again.layers, strict=True):
        np.testing.assert_array_equal(w, w_again)
        np.testing.assert_array_equal(b, b_again)


def test_the_network_of_torch_answers_the_same_without_torch(trained, tmp_path):
    policy, _ = trained
    assert len(policy.check[1]) > 30  # of torch itself
    np.testing.assert_allclose(by_hand(policy, policy.check[0]), policy.check[1], atol=1e-9)
    policy.save(tmp_path / "policy")
    policies.load(tmp_path / "policy", model=model_of(SEAL))


def test_a_training_without_loops_to_hold_out_or_without_answers_is_refused(tmp_path):
    training = pytest.importorskip("hybrid_sysid_ros.control.policy.training", exc_type=ImportError)
    store = SampleStore(tmp_path / "samples", "hopeless")
    settings = Settings(episodes=(2,), epochs=1, workers=1)
    for seed in (0, 1):
        store.keep(seed, nothing_solved())
    with pytest.raises(UserError, match="the exact MPC found no solution"):
        training.train(model_of(SEAL), PROBLEM, SPREAD, settings, seed=0, store=store)
    for episodes in ((), (1,), (5, 0)):
        with pytest.raises(UserError, match="at least 2 closed loops in every round"):
            Settings(episodes=episodes)


@pytest.fixture(scope="module")
def rich():
    """A tiny training with derivatives of the answers and a parameter to follow."""
    training = pytest.importorskip("hybrid_sysid_ros.control.policy.training", exc_type=ImportError)
    settings = Settings(
        episodes=(8,),
        hidden=(24,),
        epochs=60,
        batch=128,
        workers=1,
        slope_weight=0.1,
        slope_share=0.5,
        adaptation=Adaptation(names=("centre",), spread=(0.5,)),
    )
    return training.train(model_of(SEAL), PROBLEM, SPREAD, settings, seed=1)


def test_a_training_with_derivatives_and_a_followed_parameter_imitates_the_mpc_of_another_plant(rich):
    """Told of another centre, the policy is nearer to the MPC that knows it than a policy that is not told."""
    system = model_of().system
    other = dataclasses.replace(system, centre=system.centre + 0.5)
    fresh = sample(other, PROBLEM, dataclasses.replace(SPREAD, kick=(0.0, 0.0)), 424242)
    rows = list(zip(fresh.states, fresh.disturbances, fresh.previous, fresh.previews, strict=True))
    errors = []
    for centre in (system.centre, other.centre):
        rich.adapt({"centre": centre})
        answers = [rich.control(x, np.array([d]), np.array([u]), q).input[0] for x, d, u, q in rows]
        errors.append(np.sqrt(np.mean((np.array(answers) - fresh.inputs[:, 0]) ** 2)))
    rich.adapt({"centre": system.centre})
    assert errors[1] < 0.7 * errors[0]
