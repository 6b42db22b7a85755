"""Inputs that act with the other sign: on a cart on a line, where all is known in closed form, and on the vehicle."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.estimation.monitored_estimator import MonitoredEstimator, MonitorSettings
from hybrid_sysid_ros.estimation.reversed_input import (
    CONSISTENT,
    MEMORY,
    NONE,
    RATIO,
    SURE,
    WRONG,
    ReversalTrial,
    acts_reversed,
    may_compete,
)
from hybrid_sysid_ros.estimation.sensor_monitor import SensorMonitor
from hybrid_sysid_ros.estimation.tuning import Tuning

PERIOD, NOISE, PUSH = 0.01, 0.001, 2.0


class PushedCart(System):
    """x' = v, v' = a: both are measured."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("push [m/s^2]",)
    outputs = ("place", "speed")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0]


def estimator(reversible=1.0):
    return MonitoredEstimator(
        ExtendedKalmanFilter,
        PushedCart(),
        Tuning(
            measurement_noise=(NOISE, NOISE), process_noise=(1e-4, 1e-3), disturbance_noise=(0.1,),
            disturbance_limit=(1.0,), initial_deviation=(0.1, 0.1),
        ),
        MonitorSettings(
            largest=(9.0, 9.0), least=(0.0, 0.0), leave_after=0.1, timeout=0.5, frozen_after=1.0,
            white_noise=(0.0, 0.0), doubt_disturbance=False, reversible=[reversible],
        ),
        period=PERIOD,
        latency=0.0,
    )  # fmt: skip


def driven(found, *, signs, first=0, state=(0.0, 0.0), bias=0.0, push=PUSH, seed=0):
    """Which input is reversed, and the speed's error, sample by sample of a cart whose input acts with these signs."""
    (x, v), random, known, errors, u = state, np.random.default_rng(seed), [], [], 0.0
    for k, sign in enumerate(signs, first):
        readings = np.array([x, v]) + NOISE * random.standard_normal(2) + np.array([0.0, bias])
        estimate = found.update(k * PERIOD, readings, np.array([u]))
        known.append(found.reversal.reversed)
        errors.append(estimate.state[1] - v)
        u = push * math.sin(7.0 * k * PERIOD)
        x, v = x + PERIOD * v + 0.5 * PERIOD**2 * sign * u, v + PERIOD * sign * u
    return np.array(known), np.array(errors)


def test_an_input_that_turns_is_known_by_its_index_and_later_by_its_own_sign_again():
    known, errors = driven(estimator(), signs=[1.0] * 200 + [-1.0] * 200 + [1.0] * 200)
    assert (known[:200] == NONE).all()
    assert (known[240:400] == 0).all(), "within .4 s"
    assert (known[440:] == NONE).all()
    assert np.abs(errors[240:400]).max() < 5.0 * NOISE


def test_without_a_fault_and_for_a_sensor_s_offset_no_input_is_reversed():
    assert (driven(estimator(), signs=[1.0] * 400)[0] == NONE).all()
    found = estimator()
    driven(found, signs=[1.0] * 200)
    assert (driven(found, signs=[1.0] * 200, first=200, bias=0.5)[0] == NONE).all()


def test_an_input_that_may_not_be_reversed_is_not_tried():
    found = estimator(reversible=0.0)
    assert not found.rivals
    assert (driven(found, signs=[1.0] * 200 + [-1.0] * 200)[0] == NONE).all()


@pytest.mark.parametrize("gain", [-1.5, -2.0])
def test_an_input_of_another_gain_and_the_other_sign_is_known_as_well(gain):
    assert (driven(estimator(), signs=[1.0] * 200 + [gain] * 100, push=0.4)[0][240:] == 0).all()


def test_an_input_that_turns_to_and_fro_is_known_by_its_sign_in_between():
    known, _ = driven(estimator(), signs=([1.0] * 100 + [-1.0] * 100) * 3)
    assert [int(known[k]) for k in range(99, 600, 100)] == [NONE, 0] * 3


def test_the_gain_is_that_of_least_squares_with_forgetting_and_sure_below_zero():
    """numpy's least squares of a + g b, weighted by what is remembered; L = (sum a^2 - min sum (a + g b)^2) / 2."""
    monitor = SensorMonitor([False], [1.0], largest=[3.0], least=[0.0], leave_after=0.1, timeout=1.0)
    trial, random, count, found = ReversalTrial(tried=0, product=0.0), np.random.default_rng(1), 40, []
    b = random.normal(size=count) * 3.0
    a = 0.7 * b + 0.5 * random.normal(size=count)
    for x, y in zip(a, b, strict=True):
        given = [0.0], [x + y], [x - y], PERIOD
        found.append(acts_reversed(trial, monitor.record, monitor.sensors, *given))
    root = np.sqrt((1.0 - PERIOD / MEMORY) ** np.arange(count)[::-1])
    (expected,), (least,), *_ = np.linalg.lstsq((root * b)[:, None], -root * a)
    assert -trial.product / trial.power == pytest.approx(expected) == pytest.approx(-0.7, abs=0.1)
    ratio = 0.5 * trial.product**2 / trial.power
    assert ratio == pytest.approx(0.5 * (np.sum((root * a) ** 2) - least))
    assert ratio > RATIO
    assert found.index(True) * PERIOD >= max(CONSISTENT, SURE)

    def wild(count):
        return [
            acts_reversed(trial, monitor.record, monitor.sensors, [0.0], [1e3], [1e3], PERIOD) for _ in range(count)
        ]

    assert not any(wild(round(WRONG / PERIOD) - 1)), "where no gain explains a sensor, none is believed"
    assert not math.isnan(trial.product)
    wild(2)
    assert math.isnan(trial.product), "and both begin anew"


def test_inputs_are_tried_one_after_the_other_and_one_that_is_reversed_for_its_own_sign():
    monitor = SensorMonitor([False], [1.0], largest=[9.0], least=[0.0], leave_after=0.1, timeout=1.0)
    monitor.sensors[0].large, trial, tried = 2.0, ReversalTrial(), []
    for _ in range(3):
        trial.product = math.nan
        assert may_compete(trial, monitor.sensors, [0.0], [1.0, 0.0, 1.0], PERIOD)
        tried.append(trial.tried)
    assert tried == [0, 2, 0]
    trial.product, trial.reversed = math.nan, 2
    assert may_compete(trial, monitor.sensors, [0.0], [1.0, 0.0, 1.0], PERIOD)
    assert trial.tried == 2
    monitor.sensors[0].large = 0.0
    lasting = [may_compete(trial, monitor.sensors, [0.0], [1.0, 0.0, 1.0], PERIOD) for _ in range(30)]
    trial.product = 0.0
    assert not may_compete(trial, monitor.sensors, [0.0], [1.0, 0.0, 1.0], PERIOD)
    assert not lasting[-1]
