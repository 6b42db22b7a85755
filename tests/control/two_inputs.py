"""Systems of two inputs and two outputs, for tests of control."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, sin


@dataclass(frozen=True, kw_only=True)
class Carts(System):
    """Two carts on a spring, each pushed: linear."""

    states = ("first [m]", "second [m]", "first_speed [m/s]", "second_speed [m/s]")
    inputs = ("first_force [N]", "second_force [N]")
    outputs = ("first", "second")

    spring: float = bounded(20.0, 0.0, 100.0, unit="1/s^2")
    """Per mass."""
    drag: float = bounded(0.7, 0.0, 10.0, unit="1/s")
    """Viscous friction per mass."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        pull = self.spring * (x[1] - x[0])
        return x[2], x[3], u[0] + pull - self.drag * x[2], 2.0 * u[1] - pull - self.drag * x[3]


@dataclass(frozen=True, kw_only=True)
class Arms(System):
    """Two hanging arms on a spring, the first with dry friction; what is measured is no state and reads an input."""

    states = ("first [rad]", "second [rad]", "first_rate [rad/s]", "second_rate [rad/s]")
    inputs = ("first_torque [N m]", "second_torque [N m]")
    outputs = ("height [m]", "load [N m]")
    contacts = (Dry(on="first_rate", level="friction"),)

    friction: float = bounded(0.8, 0.0, 10.0, unit="rad/s^2")
    """Dry friction on the first arm."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        pull = 5.0 * (x[1] - x[0])
        first = 8.0 * u[0] + pull - 9.0 * sin(x[0]) - 0.5 * x[2]
        return x[2], x[3], first, 6.0 * u[1] - pull - 6.0 * sin(x[1]) - 0.8 * x[3]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return sin(x[1]), 5.0 * (x[1] - x[0]) + 0.1 * u[0]


PROBLEM = ControlProblem(
    horizon=12,
    period=0.05,
    substeps=3,
    output_weights=(50.0, 2.0),
    output_scales=(0.5, 1.0),
    rate_weights=(0.1, 0.05),
    input_weights=(0.02, 0.03),
    input_low=(-1.5, -2.0),
    input_high=(2.5, 1.0),
    smoothing=0.02,
    max_iterations=200,
)


def instance(seed, size=1.0):
    """State, disturbance, previous inputs and preview."""
    random = np.random.default_rng(seed)
    preview = size * 0.4 * (random.normal(size=2) + 0.2 * np.cumsum(random.normal(size=(12, 2)), axis=0))
    return (
        size * random.normal(size=4) * [0.3, 0.3, 0.5, 0.5],
        0.2 * random.normal(size=2),
        random.normal(size=2),
        preview,
    )
