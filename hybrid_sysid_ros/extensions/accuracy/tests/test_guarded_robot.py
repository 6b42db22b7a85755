"""The balancing robot's loop behind its guard: a gyroscope that spikes, and a push, which is as sudden."""

import numpy as np
import pytest

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.extensions.accuracy.guarded_loop import guarded_loop
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.parameters import shipped

PERIOD, BEGIN, END = 0.01, 1.0, 3.0
TILT, TILT_RATE = 2, 3
SHARE, PUSH = 0.6, np.radians(216.0)


@pytest.fixture(scope="module")
def robot():
    rig = load("balancing_robot")
    model = load_model(shipped(rig.name, "model"), rig=rig.source)
    return rig, guarded_loop(rig, model, {"policy": "exact"})


def driven_loop(robot, *, spikes=0.0, push=0.0, left=lambda counts: counts, measured=True):
    """States of the loop, how often each sensor was left out, and the tilts: with spikes of the gyroscope in a SHARE of
    the readings from BEGIN to END, a tilt rate that is another one at BEGIN [rad/s], or a left motor that does other
    things with its counts from BEGIN to END. measured: and says so.
    """
    rig, loop = robot
    plant, random = Plant(rig, seed=3), np.random.default_rng(3)
    states = [item.name for item in rig.system.states]
    loop.estimator.begin()
    loop.begin()
    now, inputs, levels, tilts = np.zeros(len(rig.sensors)), loop.input.copy(), set(), []
    for k in range(round((END + 1.0) / PERIOD)):
        readings = plant.sensed()
        if BEGIN <= k * PERIOD < END and random.random() < SHARE:
            readings[TILT_RATE] += spikes
        if k == round(BEGIN / PERIOD):
            plant.state[states.index("tilt_rate")] += push
        estimate = loop.estimator.update(k * PERIOD, readings, inputs)
        inputs = loop.control(estimate, inputs, now, np.tile(now, (loop.controller.horizon, 1)), PERIOD).copy()
        acting = inputs.copy()
        if BEGIN <= k * PERIOD < END:
            acting[0] = left(acting[0])
        inputs = acting if measured else inputs
        levels.add(loop.level)
        tilts.append(plant.state[states.index("tilt")])
        for _ in range(rig.steps(PERIOD, "the period")):
            plant.advance(acting)
    return levels, loop.estimator.monitor.counts, np.abs(tilts)


@pytest.mark.parametrize("spikes", [-50.0, 50.0, 100.0])
def test_a_gyroscope_that_spikes_does_not_fell_the_robot(robot, spikes):
    """Nor is the tilt left out for it, which the spikes contradict."""
    _, left_out, tilt = driven_loop(robot, spikes=np.radians(spikes))
    assert left_out[TILT] == 0
    assert tilt.max() < 0.35


def test_a_clear_spike_leaves_the_gyroscope_out(robot):
    levels, left_out, _ = driven_loop(robot, spikes=np.radians(100.0))
    assert left_out[TILT_RATE] > 0
    assert max(levels) is LoopState.SLOWED


def test_a_robot_that_fell_is_said_to_lie_at_its_stop_and_its_wheels_rest(robot):
    rig, loop = robot
    plant, now = Plant(rig, seed=3), np.zeros(len(rig.sensors))
    loop.estimator.begin()
    loop.begin()
    inputs = loop.input.copy()
    for k in range(round(3.0 / PERIOD)):
        if k == round(BEGIN / PERIOD):
            plant.state[:] = [rig.travel[0, 0], *plant.state[1:]]  # somebody knocks it over
        estimate = loop.estimator.update(k * PERIOD, plant.sensed(), inputs)
        inputs = loop.control(estimate, inputs, now, np.tile(now, (loop.controller.horizon, 1)), PERIOD).copy()
        for _ in range(rig.steps(PERIOD, "the period")):
            plant.advance(inputs)
    assert plant.state[0] == rig.travel[0, 0], "it lies on the ground"
    assert loop.level is LoopState.RESTING
    assert "travel" in loop.guard.reason
    assert not inputs.any()


def test_a_push_is_no_fault_of_the_gyroscope(robot):
    _, left_out, tilt = driven_loop(robot, push=PUSH)
    assert sum(left_out) == 0
    assert tilt.max() < 0.5


@pytest.mark.parametrize("stuck", [-165.0, 0.0, 165.0])
def test_one_wheel_balances_the_robot_where_the_other_one_says_that_it_is_stuck(robot, stuck):
    """Both wheels push the body alike: the sum of their counts keeps it upright, whatever its yaw does."""
    _, _, tilt = driven_loop(robot, left=lambda counts: stuck)
    assert tilt.max() < 0.4


@pytest.mark.parametrize("gain", [0.0, 0.3])
def test_one_wheel_balances_the_robot_where_the_other_one_is_weak_and_does_not_say_so(robot, gain):
    _, _, tilt = driven_loop(robot, left=lambda counts: gain * counts, measured=False)
    assert tilt.max() < 0.4
