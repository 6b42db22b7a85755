"""Friction on one velocity, which a right-hand side can't hold: it is set-valued, or stiff, so a step solves it.

All levels are per unit inertia of their velocity. A field of a contact is a number, the name of a parameter or a
method(x, u) of the system, or a function(system, x, u).

    Viscous    v' = f_v - D v
    Dry        v' = f_v - F sat(v / vc) - D v
    Bristles   v' = f_v - s0 z - s1 z' - D v,  z' = v - |v| z s0 / F

F: level, vc: creep speed (0: it sticks exactly), D: viscous rate; z: deflection of the bristles, s0, s1: their
stiffness and damping. Bristles with a constant F are Dahl's friction (1968), with F(v) the LuGre friction of Canudas
de Wit et al. (1995), IEEE TAC 40(3), eqs. (1)-(3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.mathematics import Scalar, maximum, saturate, select, sqrt

Field = str | float | Callable[[Any, Any, Any], Any]

TINY = 1e-12
"""Keeps 0 / 0 out of the step of a frictionless instant."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Friction on one velocity."""

    on: str
    """Name of the velocity that carries it."""
    viscous: Field = 0.0
    """D, resolved trapezoidally."""
    fields: ClassVar[tuple[str, ...]] = ("viscous",)

    @property
    def state(self) -> str | None:
        """The hidden state that the contact brings along, as a declaration; None: none."""
        return None

    def solve(
        self, v: Scalar, pushed: Scalar, z: Scalar | None, h: Scalar, smoothing: Scalar | None, **at: Scalar
    ) -> tuple[Scalar, Scalar | None]:
        """Velocity and deflection after a step of h [s]: ``pushed`` is v + h f_v, ``at`` the fields' values.

        Viscous friction is trapezoidal: second order, where Euler's damping depends on the step.
        """
        half = 0.5 * h * at["viscous"]
        return (pushed - half * v) / (1.0 + half), None


@dataclass(frozen=True, kw_only=True)
class Viscous(Contact):
    """Friction in proportion to the velocity."""


@dataclass(frozen=True, kw_only=True)
class Dry(Contact):
    """Dry friction of a level."""

    level: Field
    creep: Field = 0.0
    """Speed below which it is viscous; 0: it sticks exactly."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "level", "creep")

    def solve(
        self, v: Scalar, pushed: Scalar, z: Scalar | None, h: Scalar, smoothing: Scalar | None, **at: Scalar
    ) -> tuple[Scalar, Scalar | None]:
        """Z = pushed - h D v / 2;  v+ = (z - sat(z c / (vc (1 + h D / 2) + c), c)) / (1 + h D / 2),   c = h F.

        With vc = 0 and |z| <= h F the velocity is exactly zero: it sticks. Moreau's time stepping for one contact
        (Moreau 1988; Acary & Brogliato 2008, section 1.4.3.4) with a regularised sign.
        """
        capacity, half = h * at["level"], 0.5 * h * at["viscous"]
        push = pushed - half * v
        # The ratio first: with vc = 0 it is 1 to the last bit, and the velocity 0.
        ratio = capacity / maximum(at["creep"] * (1.0 + half) + capacity, TINY)
        return (push - saturate(push * ratio, capacity, smoothing)) / (1.0 + half), None


@dataclass(frozen=True, kw_only=True)
class Bristles(Contact):
    """Friction of bristles of a stiffness and a damping, up to a level; their deflection is a hidden state."""

    level: Field
    stiffness: Field
    damping: Field = 0.0
    deflection: str = "deflection"
    """Name of the hidden state; its unit is that of the velocity times s unless it is said here."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "level", "stiffness", "damping")

    @property
    def state(self) -> str | None:
        return self.deflection

    def solve(
        self, v: Scalar, pushed: Scalar, z: Scalar | None, h: Scalar, smoothing: Scalar | None, **at: Scalar
    ) -> tuple[Scalar, Scalar | None]:
        """Backward Euler of bristles and velocity together, which a quadratic solves exactly at any stiffness.

        z+ = (z + h v+) / (1 + c |v+|),  c = h s0 / F            never leaves +-max(|z|, F / s0)
        (1 + h D / 2) v+ + h S z+ = b,   S = s0 + s1 / h,   b = v + h f_v - h D v / 2 + s1 z
        with r = |v+|, a = 1 + h D / 2, s = sgn(v+) = sgn(b - h S z):
        a c r^2 + (a - s b c + h^2 S) r - |b - h S z| = 0,       of which one root is positive

        Smoothed, the signs of the push and of v+ are x / sqrt(x^2 + smoothing^2).
        """
        half = 0.5 * h * at["viscous"]
        a = 1.0 + half
        c = h * at["stiffness"] / maximum(at["level"], TINY)
        b = pushed - half * v + at["damping"] * z
        total = h * at["stiffness"] + at["damping"]
        push = b - total * z
        sign = select(push > 0.0, 1.0, -1.0) if smoothing is None else _rounded_sign(push, smoothing)
        linear = a - sign * b * c + h * total
        amount = sign * push  # |push|, with its slope at rest too: an optimiser must see how to begin to move
        # The form without cancellation where the linear part is positive, the usual one where it is not.
        root = sqrt(linear * linear + 4.0 * a * c * amount)
        if smoothing is None:
            r = select(
                linear > 0.0, 2.0 * amount / maximum(linear + root, TINY), (root - linear) / maximum(2.0 * a * c, TINY)
            )
            return sign * r, (z + h * sign * r) / (1.0 + c * r)
        after = push * select(
            linear > 0.0, 2.0 / maximum(linear + root, TINY), (root - linear) / maximum(2.0 * a * c * amount, TINY)
        )
        speed = after * _rounded_sign(after, smoothing)  # none at rest, where bristles must not creep
        return after, (z + h * after) / (1.0 + c * speed)


def _rounded_sign(x: Scalar, smoothing: Scalar) -> Scalar:
    return x / maximum(sqrt(x * x + smoothing * smoothing), TINY)
