"""A system that falls when nobody holds it, for tests of what holds it."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded

RATE = 3.0
GAINS = ((16.0, 5.0),)
"""Of a stabiliser: by how much each state lowers the torque."""


@dataclass(frozen=True, kw_only=True)
class Upright(System):
    """q'' = r^2 q + u: open, an error grows by e in a third of a second."""

    states = ("angle [rad]", "speed [rad/s]")
    inputs = ("torque [rad/s^2]",)
    outputs = ("angle",)
    stepper = RungeKutta()

    rate: float = bounded(RATE, 0.1, 10.0, unit="rad/s")

    def law(self, x, u):
        return x[1], self.rate**2 * x[0] + u[0]
