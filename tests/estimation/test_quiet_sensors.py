"""Innovations that are too small: of a simulated beam without noise, and of a noise that is assumed far too large."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.runtime.estimators import estimator_of

SECONDS = 3.0


def doubt_of(noise, *, noisy):
    """The largest doubt of an estimate of the beam, which a sine drives. noise: the assumed one [V]."""
    rig = load("cam_beam")
    if not noisy:
        rig = replace(rig, sensors=tuple(replace(sensor, white_noise=0.0, hum=None) for sensor in rig.sensors))
    values = defaults(rig, "estimator")
    estimator = estimator_of(
        rig, rig.system, {**values, "measurement_noise": [noise or values["measurement_noise"][0]]}
    )
    plant, inputs, doubt, period = Plant(rig, seed=1, disturbed=False), np.zeros(1), 0.0, 1.0 / values["rate"]
    for k in range(round(SECONDS / period)):
        estimator.update(k * period, plant.sensed(), inputs)
        doubt = max(doubt, estimator.doubt)
        inputs = np.array([4.0 * math.sin(3.0 * k * period)])
        for _ in range(rig.steps(period, "the period")):
            plant.advance(inputs)
    return doubt


@pytest.mark.parametrize("noisy", [True, False])
def test_a_right_model_is_not_doubted_with_noise_or_without(noisy):
    assert doubt_of(None, noisy=noisy) < 1.0


def test_a_noise_that_is_assumed_far_too_large_is_doubted():
    assert doubt_of(1e9, noisy=True) > 1.0
