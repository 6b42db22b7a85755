"""The base of every contact, viscous friction, and levels of dry friction over speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.mathematics import Scalar, absolute, exp, maximum, select, sqrt

Field = str | float | Callable[[Any, Any, Any], Any]
Fields = Mapping[str, Any]
"""Values of a contact's fields."""

TINY = 1e-12
"""Added where a step without friction would divide zero by zero."""

Solved = tuple[Scalar, Sequence[Scalar]]
"""Velocity and hidden states after a step."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Friction on one velocity."""

    on: str
    """Name of the velocity on which it acts."""
    viscous: Field = 0.0
    """D, integrated by the trapezoidal rule."""
    fields: ClassVar[tuple[str, ...]] = ("viscous",)
    hidden_power: ClassVar[int] = 1
    """Power of s between the unit of hidden states and the velocity's: 1 for a displacement, -1 an acceleration."""

    @property
    def hidden(self) -> tuple[str, ...]:
        """Declarations of the hidden states that the contact adds."""
        return ()

    def solve(
        self, v: Scalar, pushed: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Solved:
        """Velocity and hidden states after a step of h [s]; ``pushed`` is v + h f_v, ``at`` holds the fields' values.

        Viscous friction uses the trapezoidal rule: it is of second order, where Euler's damping depends on the step.
        """
        half = 0.5 * h * at["viscous"]
        return (pushed - half * v) / (1.0 + half), ()


@dataclass(frozen=True, kw_only=True)
class Viscous(Contact):
    """Friction in proportion to the velocity."""


def rounded_sign(x: Scalar, smoothing: Scalar) -> Scalar:
    """Return x / sqrt(x^2 + smoothing^2)."""
    return x / maximum(sqrt(x * x + smoothing * smoothing), TINY)


def stribeck(v: Scalar, coulomb: Scalar, static: Scalar, speed: Scalar) -> Scalar:
    """Level F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2) [units of Fc].

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. (3) with exponent 2. The sign of
    the velocity is applied by the contact.
    """
    ratio = v / speed
    return coulomb + (static - coulomb) * exp(-ratio * ratio)


def rational_stribeck(v: Scalar, coulomb: Scalar, excess: Scalar, speed: Scalar) -> Scalar:
    """Level F(v) = Fc + dF / (1 + (v / vs)^2)^2 [units of Fc]: a Stribeck curve with a heavier tail and no exp()."""
    ratio = v / speed
    bell = 1.0 + ratio * ratio
    return coulomb + excess / (bell * bell)


def stefanski(
    v: Scalar,
    acceleration: Scalar,
    coulomb: Scalar,
    static: Scalar,
    speed_shape: Scalar,
    acceleration_shape: Scalar,
    *,
    growing: Scalar | None = None,
) -> Scalar:
    """Level F(v, v') = Fc + (Fs - Fc) exp(-a1 |v| / (|v'| + a2)) sgn(v v') [units of Fc]. It is higher while the speed
    grows than while it falls, so that friction over speed is a loop.

    At rest it is the static level. growing: sgn(v v') in its rounded form. Source: Wojewoda, Stefanski, Wiercigroch,
    Kapitaniak (2008), Phil. Trans. R. Soc. A 366, 747-765, on hysteretic dry friction; the formula is given as it is
    commonly quoted, and was not compared with the paper's own print.
    """
    decay = exp(-speed_shape * absolute(v) / (absolute(acceleration) + acceleration_shape))
    if growing is None:
        growing = select(v * acceleration < 0.0, -1.0, 1.0)
    return coulomb + (static - coulomb) * decay * growing
