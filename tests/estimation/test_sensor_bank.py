"""Estimates without one sensor each: on the robot, whose heading and its rate contradict each other if one is wrong."""

import math

import numpy as np
import pytest

from hybrid_sysid_ros.estimation.sensor_bank import (
    PROBATION,
    BankMember,
    SensorTrial,
    agrees,
    explains,
    suspect,
    weigh,
)
from hybrid_sysid_ros.estimation.sensor_monitor import SensorMonitor
from hybrid_sysid_ros.estimation.sensor_monitoring import NONE
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.runtime.estimators import estimator_of, prediction_step

STEP, BEGIN = 0.01, 1.0
SPEED, YAW, RATE = 0, 1, 4
"""Of the robot's outputs."""


@pytest.mark.parametrize(("identified", "steps"), [(0.01, 1), (0.005, 2), (0.001, 2)])
def test_an_estimate_goes_on_by_the_steps_of_the_identification_or_by_5_ms(identified, steps):
    rig = load("balancing_robot")
    sampling = Sampling(step=identified, period=0.02)
    model = Model(
        rig="", structure="gray", system=rig.system, sampling=sampling, names=(), covariance=np.zeros((0, 0)),
        training_range={},
    )  # fmt: skip
    estimator = estimator_of(rig, rig.system, defaults(rig, "estimator"), step=prediction_step(model))
    for k in range(2):
        estimator.update(k * STEP, np.zeros(5), np.zeros(2))
    moments = estimator.filter._memory.moments["time"][: steps + 1]
    np.testing.assert_allclose(moments, np.arange(steps + 1) * STEP / steps, atol=1e-12)


@pytest.fixture(scope="module")
def robot():
    rig = load("balancing_robot")
    return rig, estimator_of(rig, rig.system, defaults(rig, "estimator"))


def driven(robot, change, *, seconds=2.5, seed=1):
    """Which sensors were left out (samples, p), and the error of the yaw [rad], where a robot turns to and fro, held up
    by what its states really are; change: of its readings (p,), in place, from BEGIN on.
    """
    rig, estimator = robot
    estimator.begin()
    plant, out, errors, inputs = Plant(rig, seed=seed, disturbed=False), [], [], np.zeros(2)
    gains = np.array(rig.experiments.stabiliser)
    for k in range(round(seconds / STEP)):
        readings = plant.sensed().copy()
        if k * STEP >= BEGIN:
            change(readings, k * STEP - BEGIN)
        estimate = estimator.update(k * STEP, readings, inputs)
        out.append(list(estimator.monitor.left_out))
        errors.append(estimate.state[1] - plant.outputs()[YAW])
        turn = 60.0 * math.sin(6.0 * k * STEP)
        inputs = np.clip(-gains @ plant.state + [turn, -turn], *rig.limits)
        for _ in range(rig.steps(STEP, "the period")):
            plant.advance(inputs)
    return np.array(out), np.array(errors)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_rate_with_the_wrong_sign_is_left_out_and_not_the_angle_that_contradicts_it(robot, seed):
    def turned(readings, since):
        readings[RATE] = -readings[RATE]

    out, errors = driven(robot, turned, seed=seed)
    after = out[round((BEGIN + 0.3) / STEP) :]
    assert after[:, RATE].mean() > 0.8
    assert not after[:, np.arange(5) != RATE].any()
    assert np.abs(errors[round(BEGIN / STEP) :]).max() < math.radians(6.0)


def test_a_speed_that_drifts_is_found_before_the_others_contradict_the_model(robot):
    def drifts(readings, since):
        readings[SPEED] += 0.5 * since

    out, _ = driven(robot, drifts)
    assert out[round((BEGIN + 0.3) / STEP) :, SPEED].all()


def test_no_sensor_is_left_out_of_a_sound_robot(robot):
    out, _ = driven(robot, lambda readings, since: None, seconds=5.0)
    assert not out.any()


def weighed(squares, *, steps, places=(1, 2)):
    """Members of a bank of two sensors, whose estimates have these normalised squares of the other one."""
    members, sensors = [BankMember(place) for place in places], monitor().sensors
    for _ in range(steps):
        for k, square in enumerate(squares):
            normalised = [square, square]
            normalised[k] = math.nan
            weigh(members, k, sensors, normalised, STEP)
    return members


def suspected(members):
    return suspect(members, monitor().sensors)


def monitor():
    return SensorMonitor(
        (True, True), [1.0] * 2, largest=[9.0] * 2, least=[0.0] * 2, leave_after=0.05, timeout=0.1
    )  # fmt: skip


def test_the_sensor_without_which_the_others_agree_is_suspected():
    assert suspected(weighed([1.0, 90.0], steps=50)) == 0
    assert suspected(weighed([90.0, 1.0], steps=50)) == 1
    assert suspected(weighed([90.0, 90.0], steps=50)) == NONE, "the model or an actuator is wrong"
    assert suspected(weighed([1.0, 90.0], steps=50, places=(0, 1))) == NONE, "the others do not tell the state"
    assert explains(weighed([1.0, 90.0], steps=50), 0, inputs=0)
    assert not explains(weighed([8.0, 90.0], steps=50), 0, inputs=0)
    assert not explains(weighed([1.0, 90.0], steps=50), 0, inputs=1), "its disturbance may explain the other one"


def test_an_estimate_that_begins_anew_is_not_suspected_less():
    """It believes all sensors at first."""
    members, sensors = weighed([90.0, 1.0], steps=100), monitor().sensors
    for _ in range(15):
        weigh(members, 0, sensors, [math.nan, 1.0], STEP)
    assert suspect(members, sensors) == 1


@pytest.mark.parametrize(("is_back", "enough"), [(True, 0.2), (False, PROBATION)])
def test_a_sensor_that_still_contradicts_the_others_must_agree_for_longer(is_back, enough):
    second, tried, count = monitor(), SensorTrial(0.2, agreed=0.0), 1
    while not agrees(tried, second.record, second.sensors, [3.0, 4.0], [1.0, 1.0], is_back, STEP):
        count += 1
    assert count * STEP == pytest.approx(enough, abs=2 * STEP)


def test_none_is_suspected_where_two_explain_the_others_alike():
    assert suspected(weighed([1.0, 1.5], steps=50)) == NONE


def test_time_does_not_pass_twice_where_a_further_estimate_is_tried():
    """In C it is judged with the monitor of the loop's own."""
    record = monitor().record
    record.given_up = 0.0
    agrees(SensorTrial(0.2, 0.0), record, monitor().sensors, [3.0, 4.0], [1.0, 1.0], False, STEP)
    assert record.given_up == 0.0
