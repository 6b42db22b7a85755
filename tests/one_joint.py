"""One joint for tests: linear systems, with each of the textbook frictions, and recurrences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import pytest

from hybrid_sysid_ros.core import Bristles, Contact, Dry, Recurrence, System, Variable, Viscous, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar

POSITION = (Variable(name="position", unit="rad"),)
VELOCITY = (Variable(name="velocity", unit="rad/s"),)
DRIVE = (Variable(name="drive", unit="V"),)


def narx(
    *,
    exponents: Sequence[tuple[int, ...]],
    coefficients: Sequence[float],
    output_lags: int,
    input_lags: int,
    output_range: tuple[float, float],
    input_range: tuple[float, float],
    output_scale: float = 1.0,
    input_scale: float = 1.0,
    period: float = 0.05,
) -> Recurrence:
    """A polynomial of one output and one input; without its extension the test is skipped."""
    made = pytest.importorskip("hybrid_sysid_ros.extensions.narx.narx").Narx
    return made(
        outputs=POSITION,
        inputs=DRIVE,
        exponents=(tuple(exponents),),
        coefficients=tuple(coefficients),
        output_lags=output_lags,
        input_lags=input_lags,
        scales=(output_scale, input_scale),
        low=(output_range[0], input_range[0]),
        high=(output_range[1], input_range[1]),
        period=period,
    )


def recurrent(units: int, *, scales: tuple[float, ...] = (0.05, 0.2, 4.0), period: float = 0.05) -> System:
    """A network of zeros for one output and one input; without its extension the test is skipped."""
    made = pytest.importorskip("hybrid_sysid_ros.extensions.recurrent.recurrent").Recurrent
    return made(units=units, outputs=POSITION, inputs=DRIVE, rates=VELOCITY, scales=scales, period=period)


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


@dataclass(frozen=True, kw_only=True)
class Stribeck(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - [Fc + (Fs - Fc) exp(-(v / vs)^2)] sgn v, per unit inertia.

    The printed law of the lecture lost sgn(v); this is the corrected one. Fs = coulomb + static_excess.
    """

    contacts: ClassVar[tuple[Contact, ...]] = (Dry(on="velocity", level="friction", viscous="damping"),)

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Friction level at speed."""
    static_excess: float = bounded(0.2, 0.0, 100.0, spread=0.5, unit="rad/s^2")
    """Friction at rest above that level."""
    stribeck_speed: float = bounded(0.05, 0.005, 2.0, spread=0.05, unit="rad/s")
    """Speed at which the excess is gone."""

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Level of the dry friction [rad/s^2]."""
        return stribeck(x[1], self.coulomb, self.coulomb + self.static_excess, self.stribeck_speed)


@dataclass(frozen=True, kw_only=True)
class Dahl(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z,  z' = v (1 - s0 z / Fc sgn v), per unit inertia.

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, Fc = coulomb. Source: Dahl (1968), with exponent 1.
    """

    contacts = (Bristles(on="velocity", level="coulomb", stiffness="bristle_stiffness", viscous="damping"),)

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Friction level."""
    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """Of the bristles."""


@dataclass(frozen=True, kw_only=True)
class LuGre(Stribeck):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z - s1 z',  z' = v - |v| s0 z / F(v), per unit inertia,
    F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2).

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, s1 = bristle_damping. Source: Canudas de Wit, Olsson,
    Astrom, Lischinsky (1995), IEEE TAC 40(3), eqs. (1)-(4).
    """

    contacts = (
        Bristles(
            on="velocity",
            level="friction",
            stiffness="bristle_stiffness",
            damping="bristle_damping",
            viscous="damping",
        ),
    )

    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """Of the bristles."""
    bristle_damping: float = bounded(1.0, 0.0, 200.0, spread=10.0, unit="1/s")
    """Of the bristles."""
