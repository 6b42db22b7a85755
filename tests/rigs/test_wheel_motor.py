"""The wheel's motor: its physics, its counter of pulses, and what ships for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.sensor import Quantiser, Sensor
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

STEP = 1e-3


@pytest.fixture(scope="module")
def rig():
    return rigs.load("wheel_motor")


def speeds(system, counts: float, seconds: float = 3.0):
    """Speed at every step under a constant input."""
    return simulate(system, np.zeros(1), np.full((round(seconds / STEP), 1), counts), step=STEP)[:, 0]


@pytest.mark.parametrize("counts", [120.0, -200.0])
def test_its_steady_speed_is_what_dead_zone_and_friction_leave(rig, counts):
    """w = K (u - U0) - wc, the corners of the dead zone being far."""
    system = rig.system
    expected = np.sign(counts) * (system.gain * (abs(counts) - system.dead_zone) - system.coulomb)
    assert speeds(system, counts)[-1] == pytest.approx(expected, rel=2e-3)


def test_within_the_dead_zone_it_rests(rig):
    assert np.all(speeds(rig.system, 0.9 * rig.system.dead_zone) == 0.0)


def test_it_gathers_speed_by_its_time_constant(rig):
    """w(t) = w_end (1 - exp(-t / tau)) from rest."""
    found = speeds(rig.system, 200.0)
    expected = found[-1] * (1.0 - np.exp(-STEP * np.arange(len(found)) / rig.system.time_constant))
    np.testing.assert_allclose(found, expected, atol=0.01 * found[-1])


def test_pulses_are_counted_over_a_window(rig):
    """Readings are whole pulses, none is lost, and their mean is the speed, however coarse they are."""
    sensor = replace(rig.sensors[0], white_noise=0.0)
    plant = Plant(replace(rig, sensors=(sensor,)), seed=0)
    readings, truth = [], []
    for k in range(4000):
        plant.advance(130.0)
        if k % 10 == 9 and k > 2000:
            readings.append(plant.sensed()[0] / sensor.scale)
            truth.append(plant.outputs()[0] / sensor.scale)
    assert set(np.round(np.array(readings) / 16.0, 9)) == {8.0, 9.0}  # 8.x pulses in 10 ms
    assert np.mean(readings) == pytest.approx(np.mean(truth), abs=16.0 / len(readings))


def test_the_counter_s_noise_is_the_one_that_is_stated(rig):
    sensor = Sensor(unit="rpm", scale=rig.sensors[0].scale, white_noise=2.5, window=0.01)
    plant, found = Plant(replace(rig, sensors=(sensor,)), seed=1), []
    for _ in range(20_000):
        plant.advance(0.0)
        found.append(plant.sensed()[0] / sensor.scale)
    assert np.std(found) == pytest.approx(2.5, rel=0.05)


def test_a_window_that_makes_no_sense_is_refused(rig):
    with pytest.raises(UserError, match="a counter of pulses, one with a window, has no range"):
        Sensor(unit="rpm", window=0.01, quantiser=Quantiser(range=300.0, bits=8))
    with pytest.raises(UserError, match=r"sensors\.speed\.window, 0\.0105 s, is no multiple of the step"):
        Plant(replace(rig, sensors=(replace(rig.sensors[0], window=0.0105),)), seed=0)


def test_what_ships_belongs_together_and_knows_the_rig(rig):
    """The identified numbers are the rig's within four standard errors; the counter's mean age counts as delay."""
    model = load_model(configuration.shipped(rig.name, "model"))
    truth = {**rig.system.named, "pwm_delay": rig.system.pwm_delay + 0.5 * (rig.sensors[0].window - rig.step)}
    found = model.system.named
    for name, error in model.standard_errors.items():
        assert abs(found[name] - truth[name]) < 4.0 * error, name
    shipped = policy.load(configuration.shipped(rig.name, "policy"), model=model)
    values = configuration.defaults(rig.name, "controller")
    assert shipped.problem == configuration.mpc_problem(values, rig, model.system)
    assert shipped.certificate is not None
    assert shipped.certificate.rates["supervised"]["mixture"]["bounds"] >= 0.99
