"""A drill string: a motor turns a bit through a slender shaft, and friction at the bit makes it stick and slip.

No values of the source's rig are public: those here are plausible ones of a laboratory rig, under whose speed loop the
bit sticks a third of the time at 2 rad/s. Its inertias are known, as the source's are. The brake on the bit, raised by
hand, is a state that nothing but the hand moves: the gray boxes that are identified do not have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from hybrid_sysid_ros.core import Bristles, Contact, Dry, RecordMap, System, bounded
from hybrid_sysid_ros.core.friction import stefanski, stribeck
from hybrid_sysid_ros.core.mathematics import Scalar, maximum, sign

MOMENT = 0.1  # s


@dataclass(frozen=True, kw_only=True)
class DrillString(System):
    """d' = wd - wm,  Jd wd' = -k d - (c + cd) wd + c wm - Tf,  Jm wm' = k d + c wd - (c + cm) wm + tau(t - delay).

    Twist d of the shaft [rad], speeds wd of the bit and wm of the top, torque tau of the motor. A subclass defines the
    bit's friction Tf.
    """

    states: ClassVar[Any] = ("twist [rad]", "bit_speed [rad/s]", "top_speed [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("bit_speed", "top_speed")
    delays = {"torque": "torque_delay"}

    stiffness: float = bounded(0.265, 0.05, 1.0, start=0.2, unit="N m/rad")
    """k, of the shaft."""
    shaft_damping: float = bounded(0.005, 0.0, 0.1, start=0.01, unit="N m s/rad")
    """c, of the shaft."""
    bit_damping: float = bounded(0.005, 0.0, 0.1, start=0.01, unit="N m s/rad")
    """cd, viscous, at the bit."""
    top_damping: float = bounded(0.01, 0.0, 0.1, start=0.02, unit="N m s/rad")
    """cm, viscous, at the top."""
    bit_inertia: float = bounded(0.03, 0.005, 0.2, unit="kg m^2", fixed=True)
    """Jd, known."""
    top_inertia: float = bounded(0.02, 0.005, 0.2, unit="kg m^2", fixed=True)
    """Jm, known."""
    torque_delay: float = bounded(0.01, 0.0, 0.05, start=0.005, unit="s")
    """Delay of the motor's drive."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        wd, wm = x[1:3]
        top = (-self.drive(x) - self.top_damping * wm + u[0]) / self.top_inertia
        return wd - wm, (self.drive(x) - self.bit_damping * wd) / self.bit_inertia, top

    def drive(self, x: Sequence[Scalar]) -> Scalar:
        """Torque of the shaft on the bit, -k d - c (wd - wm) [N m]."""
        d, wd, wm = x[:3]
        return -self.stiffness * d - self.shaft_damping * (wd - wm)


@dataclass(frozen=True, kw_only=True)
class CoulombString(DrillString):
    """Tf = Tc sgn wd."""

    contacts: ClassVar[tuple[Contact, ...]] = (Dry(on="bit_speed", level="level"),)

    coulomb: float = bounded(0.20, 0.0, 2.0, start=0.1, unit="N m")
    """Tc."""

    def level(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level [rad/s^2]."""
        return self.friction(x) / self.bit_inertia

    def friction(self, x: Sequence[Scalar]) -> Scalar:
        """Friction of the bit [N m]."""
        return self.coulomb


@dataclass(frozen=True, kw_only=True)
class StribeckString(CoulombString):
    """Tf = [Tc + (Ts - Tc) exp(-(wd / Vs)^2)] sgn wd."""

    static_excess: float = bounded(0.20, 0.0, 2.0, start=0.1, unit="N m")
    """Ts - Tc: friction at rest above Tc."""
    stribeck_speed: float = bounded(1.0, 0.1, 10.0, start=2.0, unit="rad/s")
    """Vs."""

    def friction(self, x: Sequence[Scalar]) -> Scalar:
        return stribeck(x[1], self.coulomb, self.coulomb + self.static_excess, self.stribeck_speed)


@dataclass(frozen=True, kw_only=True)
class DahlString(CoulombString):
    """Tf = s0 z,  z' = wd (1 - s0 z / Tc sgn wd)."""

    contacts = (Bristles(on="bit_speed", level="level", stiffness="bristles"),)

    bristle_stiffness: float = bounded(30.0, 1.0, 1000.0, start=10.0, unit="N m/rad")
    """s0."""

    def bristles(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Stiffness of the bristles [1/s^2]."""
        return self.bristle_stiffness / self.bit_inertia


@dataclass(frozen=True, kw_only=True)
class HystereticString(CoulombString):
    """Tf = Tc [1 + (Ts - Tc) / Tc exp(-a1 |wd| / (|wd'| + a2)) sgn(wd wd')] sgn wd.

    It is higher while the bit accelerates than while it decelerates, and up to Ts at rest. wd' is the acceleration
    under Tc alone, so that the law is explicit.
    """

    static_excess: float = bounded(0.20, 0.0, 2.0, start=0.1, unit="N m")
    """Ts - Tc."""
    decay: float = bounded(20.0, 0.1, 500.0, start=10.0, unit="1/s")
    """a1."""
    least_acceleration: float = bounded(10.0, 0.1, 500.0, start=10.0, unit="rad/s^2")
    """a2."""

    def friction(self, x: Sequence[Scalar]) -> Scalar:
        rate = (self.drive(x) - self.coulomb * sign(x[1])) / self.bit_inertia
        static = self.coulomb + self.static_excess
        return maximum(stefanski(x[1], rate, self.coulomb, static, self.decay, self.least_acceleration), 0.0)


@dataclass(frozen=True, kw_only=True)
class BrakedString(StribeckString):
    """The rig itself: Stribeck's friction, and a brake at the bit, Tf = [Tc + (Ts - Tc) exp(-(wd/Vs)^2) + B] sgn wd."""

    states = ("twist [rad]", "bit_speed [rad/s]", "top_speed [rad/s]", "brake [N m]")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """The brake is constant. An estimate is negative where the bit has less friction than Tc; below -Tc, where it
        would push, it returns.
        """
        return *super().law(x, u), maximum(-self.coulomb - x[3], 0.0) / MOMENT

    def friction(self, x: Sequence[Scalar]) -> Scalar:
        return maximum(super().friction(x) + x[3], 0.0)

    def record_map(self) -> RecordMap:
        """Only the twist is unobserved, since records for identification are made with the brake off."""
        return replace(super().record_map(), unobserved=[0])


SYSTEM = BrakedString()
STRUCTURES = {
    "coulomb": CoulombString(),
    "stribeck": StribeckString(),
    "dahl": DahlString(),
    "hysteretic": HystereticString(),
}
