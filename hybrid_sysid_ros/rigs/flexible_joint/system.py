"""A flexible-joint manipulator: a motor turns a link through an elastomer spring.

No record of the source's rig is public, and no parameter values: those here are plausible ones of a small servo, whose
free-free resonance is at 7 Hz. The rig has what its models lack: an elastomer that damps and stiffens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from hybrid_sysid_ros.core import Bristles, Contact, Dry, RecordMap, System, Viscous, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class FlexibleJoint(System):
    """J d'' = tau - t(d - q) - Ff,  I q'' = t(d - q): motor angle d, link angle q [rad], torque tau [N m].

    The spring is linear, t = Ke (d - q); a subclass defines Ff.
    """

    states = ("motor_angle [rad]", "link_angle [rad]", "motor_speed [rad/s]", "link_speed [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("motor_angle", "link_speed")
    features = ("twist [rad]", "motor_speed", "link_speed", "torque")

    motor_inertia: float = bounded(0.012, 0.002, 0.1, start=0.01, unit="kg m^2")
    """J, of motor and gear, at the joint."""
    link_inertia: float = bounded(0.05, 0.005, 0.5, start=0.04, unit="kg m^2")
    """I."""
    spring: float = bounded(20.0, 1.0, 100.0, start=15.0, unit="N m/rad")
    """Ke, of the elastomer."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        d, q, motor_speed, link_speed = x
        torque = self.elastomer(d - q, motor_speed - link_speed)
        return motor_speed, link_speed, (u[0] - torque) / self.motor_inertia, torque / self.link_inertia

    def elastomer(self, twist: Scalar, rate: Scalar) -> Scalar:
        """Torque t of the spring [N m]."""
        return self.spring * twist

    def feature(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """Both angles are without limits, so only the twist and no angle is a feature."""
        return x[0] - x[1], x[2], x[3], u[0]

    def record_map(self) -> RecordMap:
        """The motor's angle shows the link's except for the twist, which follows from I q'' = Ke (d - q)."""
        known = super().record_map()

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            states = known.states_from_record(outputs, rates, inputs)
            states[:, 1] = outputs[:, 0] - self.link_inertia / self.spring * rates[:, 1]
            return states

        shown = {**known.reconstructible, 1: (0, False)}
        rest = [index for index in known.unobserved if index != 1]
        return replace(known, reconstructible=shown, unobserved=rest, states_from_record=states_from_record)


@dataclass(frozen=True, kw_only=True)
class ViscousJoint(FlexibleJoint):
    """Ff = fv d'."""

    contacts: ClassVar[tuple[Contact, ...]] = (Viscous(on="motor_speed", viscous="viscous"),)

    viscous_friction: float = bounded(0.05, 0.0, 1.0, start=0.03, unit="N m s/rad")
    """fv, of motor and gear."""

    def viscous(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Viscous rate [1/s]."""
        return self.viscous_friction / self.motor_inertia


@dataclass(frozen=True, kw_only=True)
class StribeckJoint(ViscousJoint):
    """Ff = fv d' + [fc + (fs - fc) exp(-(d'/vs)^2)] sgn d'."""

    contacts: ClassVar[tuple[Contact, ...]] = (Dry(on="motor_speed", level="level", viscous="viscous"),)

    coulomb: float = bounded(0.25, 0.0, 1.0, start=0.1, unit="N m")
    """fc."""
    static_excess: float = bounded(0.15, 0.0, 1.0, start=0.1, spread=0.1, unit="N m")
    """fs - fc: friction at rest above fc."""
    stribeck_speed: float = bounded(0.3, 0.05, 3.0, start=0.5, spread=0.3, unit="rad/s")
    """vs."""

    def level(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level [rad/s^2]."""
        static = self.coulomb + self.static_excess
        return stribeck(x[2], self.coulomb, static, self.stribeck_speed) / self.motor_inertia


@dataclass(frozen=True, kw_only=True)
class DahlJoint(FlexibleJoint):
    """Ff = s0 z,  z' = d' (1 - s0 z / fc sgn d')."""

    contacts: ClassVar[tuple[Contact, ...]] = (Bristles(on="motor_speed", level="level", stiffness="stiffness"),)

    coulomb: float = bounded(0.25, 0.0, 1.0, start=0.1, unit="N m")
    """fc."""
    bristle_stiffness: float = bounded(60.0, 1.0, 1000.0, start=30.0, unit="N m/rad")
    """s0."""

    def level(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level [rad/s^2]."""
        return self.coulomb / self.motor_inertia

    def stiffness(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Stiffness of the bristles [1/s^2]."""
        return self.bristle_stiffness / self.motor_inertia


@dataclass(frozen=True, kw_only=True)
class LugreJoint(StribeckJoint):
    """Ff = s0 z + s1 z' + fv d',  z' = d' [1 - s0 z / g(d') sgn d'],  g = fc + (fs - fc) exp(-(d'/vs)^2)."""

    contacts = (Bristles(on="motor_speed", level="level", stiffness="stiffness", damping="damping", viscous="viscous"),)

    bristle_stiffness: float = bounded(60.0, 1.0, 1000.0, start=30.0, unit="N m/rad")
    """s0."""
    bristle_damping: float = bounded(0.6, 0.0, 10.0, start=0.3, unit="N m s/rad")
    """s1."""

    def stiffness(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Stiffness of the bristles [1/s^2]."""
        return self.bristle_stiffness / self.motor_inertia

    def damping(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Damping of the bristles [1/s]."""
        return self.bristle_damping / self.motor_inertia


@dataclass(frozen=True, kw_only=True)
class ElastomerJoint(LugreJoint):
    """The rig itself: t = Ke w + k3 w^3 + ce w',  w = d - q, on LuGre's friction."""

    stiffening: float = bounded(400.0, 0.0, 5000.0, start=0.0, spread=200.0, unit="N m/rad^3", term="elastomer")
    """k3, of the elastomer: twisted by .1 rad it is a fifth stiffer."""
    elastomer_damping: float = bounded(0.05, 0.0, 1.0, start=0.0, spread=0.05, unit="N m s/rad", term="elastomer")
    """ce."""

    def elastomer(self, twist: Scalar, rate: Scalar) -> Scalar:
        return self.spring * twist + self.stiffening * twist**3 + self.elastomer_damping * rate


SYSTEM = ElastomerJoint()
STRUCTURES = {"linear": ViscousJoint(), "stribeck": StribeckJoint(), "dahl": DahlJoint(), "lugre": LugreJoint()}
