"""The vehicle's loop behind its guard: an honest offset of the elevator, and a sensor with the wrong sign."""

import numpy as np
import pytest

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.extensions.accuracy.guarded_loop import guarded_loop
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.parameters import shipped

PERIOD, BEGIN = 0.02, 0.6
SPEED, ANGLE, PITCH_RATE = 0, 3, 4


@pytest.fixture(scope="module")
def vehicle():
    rig = load("winged_cone")
    model = load_model(shipped(rig.name, "model"), rig=rig.source)
    return rig, guarded_loop(rig, model, {"policy": "exact"})


def driven_loop(vehicle, seconds, *, offset=0.0, sign=1.0, elevator=1.0, measured=True, jump=0.0):
    """States of the loop, the plant in the end, and the deflections: with an offset of the elevator, a sign of the
    pitch rate, one of the elevator, which is measured or not, and a jump of the measured speed [m/s], from BEGIN on.
    """
    rig, loop = vehicle
    plant = Plant(rig, seed=3)
    loop.estimator.begin()
    loop.begin()
    now, inputs, levels, deflections = np.zeros(len(rig.sensors)), loop.input.copy(), set(), []
    for k in range(round(seconds / PERIOD)):
        late = k * PERIOD >= BEGIN
        readings = plant.sensed()
        readings[PITCH_RATE] *= sign if late else 1.0
        readings[SPEED] += jump if late else 0.0
        plant.bias[1] = offset if late else 0.0
        estimate = loop.estimator.update(k * PERIOD, readings, inputs)
        inputs = loop.control(estimate, inputs, now, np.tile(now, (loop.controller.horizon, 1)), PERIOD).copy()
        acting = inputs * [1.0, elevator if late else 1.0]
        inputs = acting if measured else inputs
        deflections.append(abs(inputs[1]))
        levels.add(loop.level)
        for _ in range(rig.steps(PERIOD, "the period")):
            plant.advance(acting)
    return levels, plant, np.array(deflections)


@pytest.mark.parametrize("offset", [-0.009, 0.009])
def test_an_offset_of_three_of_the_certificate_s_deviations_is_no_fault(vehicle, offset):
    levels, plant, _ = driven_loop(vehicle, 3.0, offset=offset)
    assert levels == {LoopState.DRIVING}
    assert abs(plant.state[ANGLE]) < 0.01


def test_a_pitch_rate_of_the_wrong_sign_is_left_out_before_the_vehicle_is_lost(vehicle):
    levels, plant, _ = driven_loop(vehicle, 3.0, sign=-1.0)
    assert vehicle[1].estimator.monitor.counts == [0, 0, 0, 0, 1]
    assert LoopState.RESTING not in levels
    assert abs(plant.state[ANGLE]) < 0.01


def test_a_pitch_rate_whose_sign_stays_wrong_does_not_lose_the_vehicle(vehicle):
    """It agrees wherever nothing turns, and is let back there."""
    _, plant, _ = driven_loop(vehicle, 12.0, sign=-1.0, offset=0.009)
    assert abs(plant.state[ANGLE]) < 0.03


def test_a_speed_that_has_jumped_stays_left_out(vehicle):
    """An estimate that begins at the wrong speed has nothing against it for seconds: the vehicle gains slowly."""
    _, plant, _ = driven_loop(vehicle, BEGIN + 3.0, jump=60.0)
    assert vehicle[1].estimator.monitor.left_out == [True, False, False, False, False]
    assert abs(plant.state[SPEED]) < 5.0


def test_a_flipped_elevator_that_reports_itself_is_sent_the_opposite(vehicle):
    """The stabiliser would turn the vehicle over with an elevator of the wrong sign."""
    levels, plant, deflections = driven_loop(vehicle, BEGIN + 2.0, elevator=-1.0)
    assert levels == {LoopState.DRIVING, LoopState.SLOWED}
    assert vehicle[1].level is LoopState.SLOWED
    assert abs(plant.state[ANGLE]) < 0.01
    assert deflections[round((BEGIN + 0.1) / PERIOD) :].max() < 0.03


def test_an_elevator_that_turns_its_sign_unreported_is_sent_the_other_one(vehicle):
    """Only the sensors can tell; an offset moves the elevator enough for that."""
    loop = vehicle[1]
    _, plant, _ = driven_loop(vehicle, BEGIN + 3.0, offset=0.003, elevator=-1.0, measured=False)
    assert loop.estimator.reversal.reversed == 1
    assert loop.level is LoopState.SLOWED
    assert "acts reversed" in loop.guard.reason
    assert abs(plant.state[ANGLE]) < 0.01
