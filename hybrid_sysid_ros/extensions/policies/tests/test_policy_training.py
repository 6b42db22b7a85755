"""A training: what it learns, what it tells about itself, and that a seed decides it."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.extensions.policies.samples import TrainingSamples, sample
from hybrid_sysid_ros.extensions.policies.tests.test_samples import CARTS_SPREAD, some_samples
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_policies import CARTS
from tests.small_policies import PROBLEM, SEAL, SPREAD, by_hand, model_of


def answers_to(policy, samples):
    """First inputs (samples, m) of a policy."""
    n, m, p = policy.states, policy.inputs, policy.outputs
    rows = (np.split(row, [n, n + m, n + 2 * m]) for row in samples.instances)
    return np.array([policy.control(x, d, u, q.reshape(-1, p)).input for x, d, u, q in rows])


def imitated(policy, samples):
    """Share of the variance of the exact MPC's first inputs that a policy leaves, the largest of all inputs."""
    first = samples.plans[:, 0]
    return np.max(np.mean((answers_to(policy, samples) - first) ** 2, axis=0) / np.var(first, axis=0))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A tiny training: a linear beam, nine closed loops in two rounds; twice, by different ways to the same samples."""
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    settings = Settings(episodes=(12, 6), hidden=(16,), epochs=120, batch=128, workers=1)
    model = model_of(SEAL)
    store: Store[dict[str, np.ndarray]] = Store(tmp_path_factory.mktemp("store") / "samples", "tiny")
    first = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    again = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    return first, again


def test_a_tiny_training_imitates_better_than_a_constant(trained):
    loops = [sample(model_of().system, PROBLEM, SPREAD, seed).arrays for seed in range(424242, 424250)]
    assert imitated(trained[0], TrainingSamples.joined(loops)) < 0.1


def test_of_two_inputs_each_is_imitated():
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    settings = Settings(episodes=(24,), hidden=(24,), epochs=60, batch=128, workers=1)
    model = dataclasses.replace(model_of(SEAL), system=CARTS.system)
    policy = training.train(model, CARTS.problem, CARTS_SPREAD, settings, seed=1)
    np.testing.assert_allclose(policy.output_map, CARTS.c[CARTS.tracked], atol=1e-9)
    assert imitated(policy, sample(CARTS.system, CARTS.problem, CARTS_SPREAD, 424242)) < 0.3


def test_a_training_tells_how_it_was_made(trained):
    record = trained[0].training
    assert record["rounds"] == [12, 6]
    assert record["samples"] + record["validation_samples"] + record["dropped"] == 18 * 20 * PROBLEM.horizon
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
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    store: Store[dict[str, np.ndarray]] = Store(tmp_path / "samples", "hopeless")
    settings = Settings(episodes=(2,), epochs=1, workers=1)
    none = {name: values[:0] for name, values in some_samples().arrays.items() if name != "dropped"}
    for seed in (0, 1):
        store.keep(seed, TrainingSamples(**none, dropped=np.array([160])).arrays)
    with pytest.raises(UserError, match="no solution"):
        training.train(model_of(SEAL), PROBLEM, SPREAD, settings, seed=0, store=store)
    for episodes in ((), (1,), (5, 0)):
        with pytest.raises(UserError, match="2 closed loops"):
            Settings(episodes=episodes)


@pytest.fixture(scope="module")
def rich():
    """A tiny training with a parameter to follow."""
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    settings = Settings(
        episodes=(16,),
        hidden=(24,),
        epochs=60,
        batch=128,
        workers=1,
        followed={"centre": 0.5},
    )
    return training.train(model_of(SEAL), PROBLEM, SPREAD, settings, seed=1)


def test_a_training_with_a_followed_parameter_imitates_the_mpc_of_another_plant(rich):
    """Told of another centre, the policy is nearer to the MPC that knows it than a policy that is not told."""
    system = model_of().system
    other = dataclasses.replace(system, centre=system.centre + 0.5)
    fresh = sample(other, PROBLEM, dataclasses.replace(SPREAD, push=(0.0, 0.0)), 424242)
    errors = []
    for centre in (system.centre, other.centre):
        rich.adapt({"centre": centre})
        errors.append(np.sqrt(np.mean((answers_to(rich, fresh) - fresh.plans[:, 0]) ** 2)))
    rich.adapt({"centre": system.centre})
    assert errors[1] < 0.7 * errors[0]


def test_the_mpc_that_is_imitated_has_its_bounds_tighter_by_the_margin():
    """Of a state with bounds on both sides by a share of its range; another's stay."""
    tightened = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError).tightened
    problem = dataclasses.replace(PROBLEM, state_low=(-0.1, -1.0), state_high=(0.3, np.inf))
    found = tightened(problem, 0.05)
    assert found.state_low == pytest.approx((-0.08, -1.0))
    assert found.state_high == pytest.approx((0.28, np.inf))
    assert tightened(problem, 0.0) == problem
    with pytest.raises(UserError, match="margin"):
        Settings(margin=0.5)
