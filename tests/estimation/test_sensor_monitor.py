"""Suspicion, frozen sensors, and sensors that contradict the model."""

import math

import numpy as np
import pytest

from hybrid_sysid_ros.estimation.frozen_sensor import frozen_detectors, is_frozen
from hybrid_sysid_ros.estimation.monitored_estimator import screen
from hybrid_sysid_ros.estimation.observability import spare_sensors
from hybrid_sysid_ros.estimation.sensor_monitor import SensorMonitor
from hybrid_sysid_ros.estimation.sensor_monitoring import AVERAGE, BLAMELESS, MISSING, NONE, STANDS_OUT, STAYS, readmit
from hybrid_sysid_ros.estimation.suspicion import CLEAREST, suspicion
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.configuration import defaults, estimator_tuning

STEP = 0.005


def monitor(spare=(True, True), **changes):
    given = {
        "largest": [9.0] * len(spare),
        "least": [0.02] * len(spare),
        "leave_after": 0.05,
        "timeout": 0.1,
        **changes,
    }
    return SensorMonitor(spare, [1.0] * len(spare), **given)


def judge(found, squares, *, readings=None, expected=None, steps=1, which=NONE, stands_out=False):
    squares = np.asarray(squares, dtype=float)
    readings = np.zeros(len(squares)) if readings is None else np.array(readings)
    for _ in range(steps):
        found.judge(readings, squares, expected, STEP, which, stands_out)


def test_suspicion_is_the_time_beyond_the_threshold():
    assert suspicion(0.0, 2.0, 0.1, 1.0) == pytest.approx(0.1)
    assert suspicion(0.1, 0.0, 0.02, 1.0) == pytest.approx(0.08)
    assert suspicion(0.08, 0.9, 0.02, 1.0) == pytest.approx(0.06), "what is below the threshold is none"
    assert suspicion(0.06, math.nan, 1.0, 1.0) == 0.0
    assert suspicion(0.0, 1e9, 0.01, 1.0) == pytest.approx((CLEAREST - 1.0) * 0.01)
    assert suspicion(0.09, 1e9, 10.0, 1.0) == 1.0


def frozen(detectors, ring, reading):
    return is_frozen(detectors[0], ring, 0, len(ring), reading)


def test_white_noise_is_not_frozen_and_what_stands_still_is():
    noise = np.random.default_rng(0).normal(0.0, 0.1, 5000)
    detector = frozen_detectors([0.1], 20)
    assert not any(frozen(*detector, value) for value in noise)
    dithered = [1.0 + 0.02 * (k % 2) for k in range(40)]
    found = [frozen(*detector, value) for value in dithered]
    assert not any(found[:20])
    assert all(found[21:])
    assert detector[0][0].count == sum(found)
    assert not frozen(*detector, 1.3)


def test_white_noise_is_not_frozen_at_a_low_rate():
    """At 50 Hz a tenth of a second has five readings, which are now and then as still by chance."""
    detector = frozen_detectors([0.1], 5)
    noise = np.random.default_rng(0).normal(0.0, 0.1, 50_000)
    assert not any(frozen(*detector, value) for value in noise.tolist())
    assert any(frozen(*detector, 1.0) for _ in range(50))


@pytest.mark.parametrize(("noise", "after"), [(0.0, 20), (0.1, 0)])
def test_a_sensor_without_noise_is_never_frozen(noise, after):
    detector = frozen_detectors([noise], after)
    assert not any(frozen(*detector, 1.0) for _ in range(100))


def test_squares_of_a_right_model_are_no_evidence():
    found, squares = monitor(), np.random.default_rng(1).chisquare(1, (20_000, 2))
    for row in squares:
        judge(found, row)
        assert found.doubt < 1.0
    assert found.counts == [0, 0]


def test_one_wild_reading_is_no_evidence():
    found = monitor()
    judge(found, [1e9, 1.0])
    judge(found, [1.0, 1.0], steps=200)
    assert found.left_out == [False, False]


@pytest.mark.parametrize("reading", [math.inf, -math.inf, 1e308, -1e10])
def test_a_reading_that_no_sensor_can_give_is_no_number(reading):
    found, outputs = monitor(), [reading, 4.0]
    assert screen(found.sensors, *frozen_detectors([0.0, 0.0], 0), outputs, [0.0, 0.0])
    assert math.isnan(outputs[0])
    assert outputs[1] == 4.0


def test_a_sensor_without_which_the_others_agree_is_left_out():
    found = monitor()
    judge(found, [100.0, 1.0], readings=[50.0, 0.0], expected=np.zeros(2), steps=20, which=0)
    assert found.left_out == [True, False]
    assert found.without == 1
    assert found.doubt < 1.0, "the estimate does without it"
    outputs = [3.0, 4.0]
    assert screen(found.sensors, *frozen_detectors([0.0, 0.0], 0), outputs, [0.0, 0.0])
    assert math.isnan(outputs[0])
    assert outputs[1] == 4.0
    judge(found, [math.nan, 1.0], readings=[50.0, 0.0], expected=np.zeros(2), steps=round(10.0 / STEP))
    assert not found.sensors[0].is_back
    judge(found, [math.nan, 1.0], readings=[0.5, 0.0], expected=np.zeros(2))
    assert found.sensors[0].is_back, "it has jumped back"
    readmit(found.sensors)
    judge(found, [1.0, 1.0])
    assert found.left_out == [False, False]
    assert found.doubt < 1.0
    found = monitor()
    judge(found, [100.0, 1.0], steps=20, which=0)
    judge(found, [math.nan, 1.0], readings=[0.5, 0.0], expected=np.zeros(2), steps=round(5 * AVERAGE / STEP))
    assert found.sensors[0].is_back, "it agrees with the estimate"


def test_less_is_evidence_where_an_estimate_explains_all_other_sensors():
    for stands_out in (False, True):
        found = monitor(largest=[200.0, 200.0])
        judge(found, [2.0 * STANDS_OUT, 1.0], steps=40, which=0, stands_out=stands_out)
        assert found.left_out == [stands_out, False]


def test_a_sensor_comes_back_where_another_one_contradicts_the_model_as_well():
    """Then the model or an actuator is wrong, and no sensor is left out for a while."""
    found = monitor()
    judge(found, [100.0, 1.0], steps=20, which=0)
    judge(found, [math.nan, 100.0], readings=[50.0, 0.0], expected=np.zeros(2), steps=40)
    judge(found, [100.0, 100.0], steps=100, which=1)
    assert found.left_out == [False, False]
    assert found.doubt > 1.0
    judge(found, [1.0, 1.0], steps=round(BLAMELESS / STEP))
    judge(found, [100.0, 1.0], steps=20, which=0)
    assert found.left_out[0]


def test_a_sensor_that_relapses_is_left_out_again():
    """A sensor with the wrong sign agrees wherever it should show zero."""
    found = monitor()
    for _ in range(2):
        judge(found, [100.0, 1.0], steps=20, which=0)
        assert found.left_out == [True, False]
        readmit(found.sensors)
    assert found.counts == [2, 0]
    assert found.sensors[0].relapses == 1


@pytest.mark.parametrize("squares", [[100.0, 100.0], [100.0, 0.0]])
def test_none_is_left_out_where_no_other_estimate_agrees(squares):
    found = monitor()
    judge(found, [1.0, squares[1]], steps=round((5.0 if squares[1] == 0.0 else 0.0) / STEP))
    judge(found, squares, steps=200)
    assert found.left_out == [False, False]
    assert found.doubt > 1.0


def three_of_which_two_jump(alone):
    found = monitor([True] * 3, alone=alone)
    judge(found, [1.0] * 3, steps=20)
    judge(found, [400.0, 400.0, 1.0], readings=[20.0, 20.0, 0.0], steps=10)
    return found


def test_none_is_believed_where_two_jump_at_once_until_they_jump_back():
    found = three_of_which_two_jump(alone=2.0)
    assert found.left_out == [True] * 3
    assert found.doubt == 0.0
    judge(found, [math.nan] * 3, readings=[20.0, 20.0, 0.0], expected=[0.0] * 3, steps=200)
    assert found.left_out == [True] * 3, "the third agrees, and is believed no more than the others"
    judge(found, [math.nan] * 3, readings=[0.0, 20.0, 0.0], expected=[0.0] * 3)
    assert found.left_out == [True] * 3
    judge(found, [math.nan] * 3, readings=[0.0] * 3, expected=[0.0] * 3)
    assert found.left_out == [False] * 3


def test_the_model_goes_on_alone_for_a_stated_time_and_once():
    found = three_of_which_two_jump(alone=0.5)
    judge(found, [math.nan] * 3, readings=[20.0, 20.0, 0.0], expected=[0.0] * 3, steps=101)
    assert found.left_out == [False] * 3
    judge(found, [400.0, 400.0, 1.0], readings=[20.0, 20.0, 0.0], steps=200)
    assert found.left_out == [False] * 3
    assert found.doubt > 1.0


@pytest.mark.parametrize("alone", [0.0, 2.0])
def test_two_that_drift_away_or_of_a_rig_that_rests_are_used(alone):
    found = three_of_which_two_jump(alone=0.0)
    assert found.left_out == [False] * 3
    found = monitor([True] * 3, alone=alone)
    for k in range(100):
        judge(found, [0.05 * k**2, 0.05 * k**2, 1.0])
    assert found.left_out == [False] * 3


def test_a_sensor_that_nobody_can_do_without_stays():
    found = monitor(spare=(False, False))
    judge(found, [100.0, 1.0], steps=200)
    assert found.left_out == [False, False]
    assert found.doubt > 1.0


def test_noise_that_is_assumed_far_too_large_is_evidence():
    found = monitor(spare=(False,))
    judge(found, [1e-6], steps=round(3.0 / STEP))
    assert found.doubt > 1.0
    found = monitor(spare=(False,), least=[0.0])
    judge(found, [0.0], steps=round(3.0 / STEP))
    assert found.doubt < 1.0


def test_a_silent_sensor_is_missing():
    found = monitor(spare=(False, True))
    judge(found, [1.0, math.nan], readings=[0.0, math.nan], steps=22)
    assert found.without == 1
    assert found.doubt < 1.0
    judge(found, [math.nan, 1.0], readings=[math.nan, 0.0], steps=22)
    assert found.doubt > 1.0, "the others do not tell the state"


def test_a_missing_sensor_that_a_camera_stands_in_for_is_not_missed():
    found = monitor(spare=(True,), covered=(True,))
    judge(found, [math.nan], readings=[math.nan], steps=100)
    assert found.without == 0
    assert found.doubt < 1.0


def test_an_angle_does_not_follow_from_a_speed_but_a_speed_from_an_angle():
    found = {}
    for name in ("flexible_joint", "cam_beam"):
        rig = rigs.load(name)
        tuning = estimator_tuning(defaults(rig, "estimator"), rig)
        found[name] = spare_sensors(rig.system, tuning, step=STEP).tolist()
    assert found == {"flexible_joint": [False, True], "cam_beam": [False]}


def test_a_reading_outside_of_the_rig_s_range_that_stays_is_evidence_though_it_is_left_out():
    found = monitor(ranges=[(-2.0, 2.0, False), (-math.inf, math.inf, False)])
    for steps, doubts in ((round(STAYS / STEP) - 1, False), (2, True)):
        judge(found, [100.0, 1.0], readings=[3.0, 0.0], expected=np.zeros(2), steps=steps, which=0)
        assert found.left_out == [True, False]
        assert bool(found.doubt == MISSING) is doubts
    judge(found, [1.0, 1.0], readings=[1.0, 0.0], expected=np.zeros(2))
    assert found.doubt < 1.0


def test_a_sensor_that_goes_on_showing_a_fall_is_believed():
    """There the model ends, so that the one sensor that shows it contradicts all others."""
    found = monitor(ranges=[(-2.0, 2.0, True), (-math.inf, math.inf, False)])
    judge(found, [100.0, 1.0], readings=[3.0, 0.0], expected=np.zeros(2), steps=round(0.5 * STAYS / STEP), which=0)
    assert found.left_out == [True, False]
    judge(found, [100.0, 1.0], readings=[3.0, 0.0], expected=np.zeros(2), steps=round(0.6 * STAYS / STEP))
    assert found.left_out == [False, False]
