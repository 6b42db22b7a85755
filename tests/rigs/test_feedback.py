"""A feedback that follows commands, limits of rate, and the signals that experiments are made of."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest

from hybrid_sysid_ros.core import System, bounded
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.excitation import constant, pulse_train, random_levels
from hybrid_sysid_ros.rigs.feedback import Feedback, Follower
from hybrid_sysid_ros.support.errors import UserError

WIDE = (np.array([-np.inf]), np.array([np.inf]))


def feedback(**changes) -> Feedback:
    """Of one input and two outputs, the first followed."""
    reported = {
        "period": 0.1,
        "followed": (0,),
        "bandwidths": np.array([2.0]),
        "wanted": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        "forward": np.array([[0.0, 0.0, 3.0]]),
        "gains": np.array([[4.0, 5.0]]),
        "integral": np.array([[0.5]]),
    }
    return Feedback(**{**reported, **changes})


def test_a_command_goes_through_the_reference_model():
    """r(t) = 1 - (1 + w t) exp(-w t), and where the outputs follow it the input is F c alone."""
    follower = Follower(feedback(), WIDE)
    for k in range(60):
        t = 0.1 * k
        faded = np.exp(-2.0 * t)
        r, rate, acceleration = 1.0 - (1.0 + 2.0 * t) * faded, 4.0 * t * faded, 4.0 * (1.0 - 2.0 * t) * faded
        np.testing.assert_allclose(follower.model[0], [r, rate], atol=1e-12)
        (u,) = follower.answer([r, rate], [1.0], [0.0])
        assert u == pytest.approx(3.0 * acceleration, abs=1e-12)


def test_an_error_is_fed_back_and_its_integral_counts_from_the_next_answer_on():
    follower = Follower(feedback(), WIDE)
    answers = [follower.answer([0.2, -0.1], [0.0], [7.0])[0] for _ in range(4)]
    proportional = 7.0 - 4.0 * 0.2 + 5.0 * 0.1
    np.testing.assert_allclose(answers, [proportional - 0.1 * 0.5 * 0.2 * k for k in range(4)])


def test_an_integral_stands_still_while_its_input_is_at_a_limit():
    follower = Follower(feedback(), (np.array([-0.1]), np.array([0.1])))
    for _ in range(5):
        assert follower.answer([1.0, 0.0], [0.0], [0.0]) == [-0.1]
    np.testing.assert_array_equal(follower.integrals, 0.0)


def test_an_actuator_goes_no_faster_than_it_can():
    actuator = Actuator(low=-1.0, high=2.0, rate=5.0)
    assert actuator.reached(9.0, 0.0, 0.1) == 0.5
    assert actuator.reached(-9.0, 0.0, 0.1) == -0.5
    assert actuator.reached(0.3, 0.0, 0.1) == 0.3
    assert actuator.reached(9.0, 1.8, 0.1) == 2.0
    with pytest.raises(UserError, match="rate is 0"):
        Actuator(low=0.0, high=1.0, rate=0.0)


def test_random_levels_stay_within_their_numbers():
    signal = random_levels(3, amplitude=2.0, shortest=1.0, longest=3.0, most=1.5, duration=500.0, begin=10.0)
    t = 0.01 * np.arange(50_000)
    values = signal(t)
    assert np.all(values[t < 10.0] == 0.0)
    changes = np.flatnonzero(np.diff(values))
    held = 0.01 * np.diff(changes)
    assert held.min() >= 1.0 - 0.011
    assert held.max() <= 3.0 + 0.011
    assert np.max(np.abs(values)) <= 2.0
    assert np.max(np.abs(np.diff(values))) <= 1.5
    with pytest.raises(UserError, match="shortest, 3 s, is above longest, 1 s"):
        random_levels(0, amplitude=1.0, shortest=3.0, longest=1.0, most=1.0, duration=5.0)


def test_pulses_come_in_time():
    signal = pulse_train(amplitude=3.0, every=10.0, width=2.0, begin=5.0)
    np.testing.assert_array_equal(signal([0.0, 4.9, 5.0, 6.9, 7.1, 15.5, 17.5]), [0.0, 0.0, 3.0, 3.0, 0.0, 3.0, 0.0])
    np.testing.assert_array_equal(constant(level=2.0, begin=1.0)([0.5, 1.0]), [0.0, 2.0])


@dataclass(frozen=True, kw_only=True)
class Pair(System):
    """Two states, of which the outputs are both."""

    states = ("way [m]", "speed [m/s]")
    inputs = ("force [N]",)
    outputs = ("way", "speed")

    inertia: float = bounded(1.0, 0.1, 10.0, unit="kg")

    def law(self, x, u):
        return x[1], u[0] / self.inertia


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"period": 0.1}, "follow is missing"),
        ({"period": 0.1, "follow": {"height": 1.0}}, "follow: height is no output; known are way, speed"),
        ({"period": 0.0, "follow": {"way": 1.0}}, "period and the rates of follow must be above 0"),
        ({"period": 0.1, "follow": {"way": 1.0}, "gains": {"push": {"way": 1.0}}}, "gains: unknown key 'push'"),
        ({"period": 0.1, "follow": {"way": 1.0}, "gains": {"force": {"speed": "x"}}}, "force.speed is 'x'"),
        ({"period": 0.1, "follow": {"way": 1.0}, "wanted": {"speed": {"way": [1.0, 2.0]}}}, "has 2 numbers"),
    ],
)
def test_what_is_wrong_with_a_feedback_is_reported(content, message):
    with pytest.raises(UserError, match=re.escape(message)):
        Feedback.of(content, Pair(), "rig.yaml: experiments: feedback")
