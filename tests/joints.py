"""A joint with each of the textbook frictions, of a few numbers with closed-form answers, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core import Bristles, Contact, System, Viscous, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Linear(System):
    """v' = gain (u - centre) - damping v - stiffness q."""

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


@dataclass(frozen=True, kw_only=True)
class Dahl(Linear):
    """And - s0 z,  z' = v (1 - s0 z / Fc sgn v): Dahl (1968) with exponent 1."""

    contacts = (Bristles(on="velocity", level="coulomb", stiffness="bristle_stiffness", viscous="damping"),)

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Fc."""
    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """s0."""


@dataclass(frozen=True, kw_only=True)
class LuGre(Linear):
    """And - s0 z - s1 z',  z' = v - |v| s0 z / F(v), F a Stribeck curve: Canudas de Wit et al. (1995)."""

    contacts = (
        Bristles(
            on="velocity", level="friction", stiffness="bristle_stiffness", damping="bristle_damping", viscous="damping"
        ),
    )

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Fc."""
    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """s0."""
    static_excess: float = bounded(0.2, 0.0, 100.0, unit="rad/s^2")
    """Friction at rest above Fc."""
    stribeck_speed: float = bounded(0.05, 0.005, 2.0, unit="rad/s")
    """Speed at which the excess is gone."""
    bristle_damping: float = bounded(1.0, 0.0, 200.0, unit="1/s")
    """s1."""

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """F(v)."""
        return stribeck(x[1], self.coulomb, self.coulomb + self.static_excess, self.stribeck_speed)
