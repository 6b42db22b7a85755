"""The lower half of a drill string: its top turns as it was recorded, its bit follows through the shaft.

Of inertia, stiffness and torque only ratios show in speeds; the measured torque fixes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class TurnedTop(System):
    """d' = wt - w,  J w' = T - Tf(w),  T = k d + c (wt - w),  Tf = [Tc + (Ts - Tc) exp(-(w / Vs)^2)] sgn w + cv w.

    wt: speed of the top, w of the bit; T: torque of the shaft, which is measured at the bit.
    """

    states = ("twist [rad]", "bit_speed [rad/s]")
    inputs = ("top_speed [rad/s]",)
    outputs = ("bit_speed", "torque [N m]")
    contacts = (Dry(on="bit_speed", level="level", viscous="viscous"),)

    inertia: float = bounded(0.02, 1e-4, 1.0, unit="kg m^2")
    """J, of the bit."""
    stiffness: float = bounded(1.6, 0.1, 10.0, unit="N m/rad")
    """k, of the shaft."""
    damping: float = bounded(0.01, 0.0, 1.0, unit="N m s/rad")
    """c, of the shaft."""
    coulomb: float = bounded(1.2, 0.0, 6.0, unit="N m")
    """Tc, at speed."""
    static_excess: float = bounded(1.6, 0.0, 6.0, unit="N m")
    """Ts - Tc, at rest above it."""
    stribeck_speed: float = bounded(14.0, 0.1, 60.0, unit="rad/s")
    """Vs."""
    bit_damping: float = bounded(0.005, 0.0, 0.5, unit="N m s/rad")
    """cv, viscous, at the bit."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return u[0] - x[1], self.torque(x, u) / self.inertia

    def torque(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Of the shaft on the bit [N m]."""
        return self.stiffness * x[0] + self.damping * (u[0] - x[1])

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], self.torque(x, u)

    def level(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level [rad/s^2]."""
        static = self.coulomb + self.static_excess
        return stribeck(x[1], self.coulomb, static, self.stribeck_speed) / self.inertia

    def viscous(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Viscous rate [1/s]."""
        return self.bit_damping / self.inertia
