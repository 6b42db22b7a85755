"""Sensors that are left out are tried by a second estimate: on the drill string, whose motor turns the bit."""

import math

import numpy as np
import pytest

from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.runtime.estimators import estimator_of

PERIOD, BEGIN, END, LAST = 0.01, 1.5, 3.5, 4.3
BIT, TOP = 0, 1


@pytest.fixture(scope="module")
def string():
    rig = load("drill_string")
    return rig, estimator_of(rig, rig.system, defaults(rig, "estimator"))


def driven(string, *, top=1.0, torque=1.0, mean=0.8):
    """Whether each sensor was left out, and the error of the bit's speed, sample by sample: with the top's speed and
    the torque that acts, about its mean [N m], times a factor from BEGIN to END.
    """
    rig, estimator = string
    estimator.begin()
    plant, inputs, out, errors = Plant(rig, seed=1, disturbed=False), np.zeros(1), [], []
    for k in range(round(LAST / PERIOD)):
        wrong = BEGIN <= k * PERIOD < END
        readings = plant.sensed().copy()
        readings[TOP] *= top if wrong else 1.0
        estimate = estimator.update(k * PERIOD, readings, inputs)
        assert estimate.state == pytest.approx(estimator.filter._look().state), "the one that is used answers"
        out.append(list(estimator.monitor.left_out))
        errors.append(estimate.state[1] - plant.outputs()[BIT])
        inputs = np.array([mean + 0.4 * math.sin(4.0 * k * PERIOD)])  # the bit turns without sticking
        for _ in range(rig.steps(PERIOD, "the period")):
            plant.advance(inputs * (torque if wrong else 1.0))
    return np.array(out), np.array(errors)


def test_a_sensor_that_lies_stays_out_and_does_not_spoil_the_estimate(string):
    out, errors = driven(string, top=-1.0)
    begin, end = round(BEGIN / PERIOD), round(END / PERIOD)
    assert out[begin + 20 : end, TOP].mean() > 0.9
    assert not out[:, BIT].any()
    assert np.sqrt(np.mean(errors[begin:end] ** 2)) < 0.1
    assert not out[-1].any(), "it is used again after the fault"


def test_a_sensor_that_was_blamed_for_a_motor_is_used_again_soon(string):
    """The estimate without it has gone astray meanwhile, so that a sound sensor contradicts that for long."""
    out, _ = driven(string, torque=-1.0, mean=2.0)
    assert out[:, TOP].any()
    assert not out[-1].any()
