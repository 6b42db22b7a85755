"""A one-joint rig, linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core import Contact, System, Viscous, bounded
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Linear(System):
    """v' = gain (u - centre) - damping v - stiffness q, which is (tau0 u - R0 v - K0 (q + d0)) / J0 without the
    inertia that the data can't tell from the gain.
    """

    states = ("position [rad]", "velocity [rad/s]")
    inputs = ("drive [V]",)
    contacts: ClassVar[tuple[Contact, ...]] = (Viscous(on="velocity", viscous="damping"),)
    delays = {"drive": "input_delay"}

    gain: float = bounded(4.0, 0.01, 400.0, unit="rad/(s^2 V)")
    """Drive gain."""
    centre: float = bounded(0.0, -5.0, 5.0, unit="V")
    """Input that balances the joint at q = 0."""
    stiffness: float = bounded(10.0, 0.0, 500.0, unit="1/s^2")
    """Spring."""
    damping: float = bounded(20.0, 0.0, 150.0, unit="1/s")
    """Viscous friction."""
    input_delay: float = bounded(0.004, 0.0, 0.03, unit="s")
    """Delay of the drive."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        q, v = x
        return v, self.gain * (u[0] - self.centre) - self.stiffness * q
