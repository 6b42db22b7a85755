"""A sled on a rail: replace it by your own rig; docs/guides/rig-file.md describes everything that a system can have."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded


@dataclass(frozen=True, kw_only=True)
class Sled(System):
    """m v' = u(t - delay) - d v - F sgn v,  q' = v."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("force [N]",)
    outputs = ("position",)
    contacts = (Dry(on="velocity", level="friction_rate", viscous="damping_rate"),)
    delays = {"force": "input_delay"}

    # value, lowest, highest; start: where fits begin
    mass: float = bounded(1.5, 0.1, 10.0, start=1.0, unit="kg")
    """m."""
    damping: float = bounded(4.0, 0.0, 50.0, start=2.0, unit="N s/m")
    """d, viscous."""
    friction: float = bounded(0.8, 0.0, 20.0, start=0.5, unit="N")
    """F, dry."""
    input_delay: float = bounded(0.004, 0.0, 0.05, start=0.002, unit="s")
    """Delay of the drive."""

    def law(self, x, u):
        """Rates of the states, without the contacts' friction, which each step solves."""
        _, velocity = x
        return velocity, u[0] / self.mass

    def friction_rate(self, x, u):
        """Friction level per unit inertia [m/s^2]."""
        return self.friction / self.mass

    def damping_rate(self, x, u):
        return self.damping / self.mass
