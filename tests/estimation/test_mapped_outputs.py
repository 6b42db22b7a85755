"""Outputs that are maps of states: a hidden link behind a spring, and an angle by where its tip is seen."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.mathematics import Scalar, cos, sin
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.estimation import Tuning
from tests.small_systems import FlexibleJoint

PERIOD = 0.005


@dataclass(frozen=True, kw_only=True)
class TwoSensors(FlexibleJoint):
    """The motor's angle and the link's speed are measured."""

    outputs: ClassVar[Any] = ("motor", "link_speed")


JOINT = Tuning(
    measurement_noise=(5e-4, 0.02),
    process_noise=(1e-4, 1e-4, 0.3, 0.1),
    disturbance_noise=(0.02,),
    disturbance_limit=(1.0,),
    initial_deviation=(0.05, 0.05, 0.5, 0.5),
    gate=25.0,
)


def joint_run(kind, *, dead: bool = False, samples: int = 1200):
    """The joint under slow and fast torques; dead: the link's speed is never told."""
    system, random = TwoSensors(), np.random.default_rng(0)
    ours = kind(system, JOINT, period=PERIOD)
    x, u, rows = np.zeros(4), 0.0, []
    for k in range(samples):
        y = x[[0, 3]] + random.normal(size=2) * JOINT.measurement_noise
        y[1] = np.nan if dead else y[1]
        rows.append((ours.update(k * PERIOD, y, np.array([u])), x))
        u = 0.9 * np.sign(np.sin(0.02 * k)) + 0.3 * np.sin(0.3 * k)
        x = one_step(system, x, np.array([u + 0.05]), step=PERIOD)
    return ours, rows


@pytest.mark.parametrize("dead", [False, True])
def test_a_flexible_joint_shows_its_hidden_link(kind, dead):
    ours, rows = joint_run(kind, dead=dead)
    errors = np.array([estimate.state - x for estimate, x in rows[400:]])
    link, link_speed = np.sqrt(np.mean(errors**2, axis=0))[[1, 3]]
    assert link < 0.005
    assert link_speed < 0.02 * (5 if dead else 1)
    assert np.mean([estimate.disturbance[0] for estimate, _ in rows[600:]]) == pytest.approx(0.05, abs=0.02)
    assert ours.counters.invalid == (1200 if dead else 0)


@dataclass(frozen=True, kw_only=True)
class Swing(System):
    """A pendulum whose tip a camera sees: q'' = u - 20 sin q - q', x = sin q, y = 1 - cos q."""

    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("across [m]", "up [m]")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] - 20.0 * sin(x[0]) - x[1]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return sin(x[0]), 1.0 - cos(x[0])


SWING = Tuning(
    measurement_noise=(0.01, 0.01),
    process_noise=(0.01, 0.2),
    disturbance_noise=(0.1,),
    disturbance_limit=(5.0,),
    initial_deviation=(0.3, 0.5),
)


def test_an_angle_comes_out_of_where_the_tip_is_seen(kind):
    """Neither output is a state; past the horizontal, where the first one turns back, the second one knows."""
    system, random = Swing(), np.random.default_rng(0)
    ours = kind(system, SWING, period=PERIOD)
    x, u, errors, squares = np.array([0.2, 0.0]), 0.0, [], []
    for k in range(1500):
        y = np.array([np.sin(x[0]), 1.0 - np.cos(x[0])]) + 0.01 * random.normal(size=2)
        estimate = ours.update(k * PERIOD, y, np.array([u]))
        errors.append(estimate.state - x)
        squares.append(estimate.normalised_innovation)
        u = 12.0 * np.sin(4.0 * k * PERIOD)
        x = one_step(system, x, np.array([u + 0.5]), step=PERIOD)
    assert np.sqrt(np.mean(np.square(errors[300:]), axis=0))[0] < 0.006  # less than a measurement's
    assert np.mean(squares[300:]) == pytest.approx(2.0, abs=0.2)
    assert np.mean(estimate.disturbance) == pytest.approx(0.5, abs=0.2)
