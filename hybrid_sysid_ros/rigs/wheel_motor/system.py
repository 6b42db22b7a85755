"""The motor of a wheeled robot: PWM counts in, speed of the wheel out.

No values of the source's robot are public: those here are plausible ones of a small geared motor on an 8-bit bridge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, dead_zone

BRIDGED = 1.75
"""Widths of the dead zone within which a solver sees a way through it."""


@dataclass(frozen=True, kw_only=True)
class WheelMotor(System):
    """tau w' = K n(u(t - delay)) - w - wc sgn w,  n(u) = u - sat(u, U0): a dead zone of U0 counts."""

    states = ("speed [rad/s]",)
    inputs = ("pwm [counts]",)
    contacts = (Dry(on="speed", level="friction", viscous="rate"),)
    delays = {"pwm": "pwm_delay"}

    gain: float = bounded(0.1466, 0.01, 1.0, start=0.1, unit="rad/s/counts")
    """K, 1.4 rpm per count."""
    time_constant: float = bounded(0.09, 0.01, 1.0, start=0.05, unit="s")
    """tau."""
    dead_zone: float = bounded(30.0, 0.0, 100.0, start=10.0, unit="counts")
    """U0 of the bridge, which does not drive below it."""
    rounding: float = bounded(5.0, 1.0, 30.0, start=5.0, spread=3.0, unit="counts")
    """Width of the dead zone's rounded corners."""
    coulomb: float = bounded(0.84, 0.0, 10.0, start=0.5, unit="rad/s")
    """wc, 8 rpm: dry friction of gear and bearings, as a loss of speed."""
    pwm_delay: float = bounded(0.015, 0.0, 0.05, start=0.005, unit="s")
    """Delay from command to drive."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        driving = dead_zone(u[0], self.dead_zone, self.rounding, over=BRIDGED)
        return (self.gain * driving / self.time_constant,)

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Level of the dry friction [rad/s^2]."""
        return self.coulomb / self.time_constant

    def rate(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Rate of the lag [1/s]."""
        return 1.0 / self.time_constant
