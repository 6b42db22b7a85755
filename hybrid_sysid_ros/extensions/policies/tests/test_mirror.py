"""Mirrored rigs: what answers the other way round there, and where nothing does."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.extensions.policies.mirror import mirror_of
from hybrid_sysid_ros.extensions.policies.tests.test_samples import CARTS_SPREAD
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration
from tests.linear_policies import CARTS
from tests.small_policies import SEAL, model_of


def sized(name):
    """A rig's system, its problem, and some of its states and inputs."""
    rig, random = rigs.load(name), np.random.default_rng(0)
    problem = configuration.mpc_problem(configuration.defaults(name, "controller"), rig).sized(rig.system)
    states = random.normal(size=(16, len(rig.system.states))) * drawn_scenarios.spread_of(rig, rig.system).push
    return rig.system, problem, states, random.uniform(problem.input_low, problem.input_high, (16, 1))


def test_a_brake_brakes_when_everything_turns_the_other_way_and_the_plan_is_the_negative_one():
    system, problem, states, inputs = sized("drill_string")
    signs = mirror_of(system, problem, states, inputs)
    assert signs is not None
    assert dict(zip((item.name for item in system.states), signs, strict=True)) == {
        "twist": -1.0,
        "bit_speed": -1.0,
        "top_speed": -1.0,
        "brake": 1.0,
    }
    wanted = np.repeat(np.linspace(-4.0, 4.0, 16)[:, None], problem.horizon * 2, axis=1)
    asked = np.column_stack([states, 0.1 * inputs, inputs, wanted])
    turned = np.column_stack([states * signs, -0.1 * inputs, -inputs, -wanted])
    mpc, begins = ExactMpc(system, problem), np.full(16, True)
    plans, images = (mpc.solve_sequence(each, begins).inputs for each in (asked, turned))
    np.testing.assert_allclose(images, -plans, atol=1e-6)


@pytest.mark.parametrize("lopsided", [{"input_low": (-1.0, -2.0)}, {"input_rest": (0.1, 0.0)}, {"state_high": (0.5,)}])
def test_a_linear_rig_has_an_image_but_with_bounds_or_a_rest_to_one_side(lopsided):
    random = np.random.default_rng(0)
    points = random.normal(size=(8, 4)), random.normal(size=(8, 2))
    problem = dataclasses.replace(CARTS.problem, input_low=(-100.0, -160.0))
    np.testing.assert_array_equal(mirror_of(CARTS.system, problem, *points), [-1.0] * 4)
    other = dataclasses.replace(problem, **lopsided).sized(CARTS.system)
    assert mirror_of(CARTS.system, other, *points) is None


def test_a_beam_that_hangs_to_one_side_has_no_image():
    assert mirror_of(*sized("cam_beam")) is None


def test_a_network_of_a_rig_with_an_image_answers_the_other_way_round():
    """It sees each sample as it is or mirrored, so what is left of the image's error is that of the network itself."""
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    settings = Settings(episodes=(12,), hidden=(16,), epochs=60, batch=128, workers=1)
    model = dataclasses.replace(model_of(SEAL), system=CARTS.system)
    problem = dataclasses.replace(CARTS.problem, input_low=(-100.0, -160.0))
    policy = training.train(model, problem, CARTS_SPREAD, settings, seed=1)
    np.testing.assert_allclose(policy.centre, 0.0, atol=1e-12)
    asked = policy.check[0]
    answers, images = policy.evaluate(asked), policy.evaluate(-asked)
    assert np.std(answers + images) < 0.2 * np.std(answers - images)
