"""Friction of bristles: Dahl's and LuGre's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.contacts.contact import TINY, Contact, Field, Solved, rounded_sign
from hybrid_sysid_ros.core.mathematics import Scalar, maximum, select, sqrt


@dataclass(frozen=True, kw_only=True)
class Bristles(Contact):
    """Friction of bristles of a stiffness and a damping, up to a level; their deflection is a hidden state.

    With a constant level it is Dahl's friction (1968), with one that falls with speed the LuGre friction of Canudas de
    Wit et al. (1995), IEEE TAC 40(3), eqs. (1)-(3).
    """

    level: Field
    stiffness: Field
    damping: Field = 0.0
    deflection: str = "deflection"
    """Name of the hidden state; its unit is that of the velocity times s unless it is said here."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "level", "stiffness", "damping")

    @property
    def hidden(self) -> tuple[str, ...]:
        return (self.deflection,)

    def solve(
        self,
        v: Scalar,
        pushed: Scalar,
        hidden: Sequence[Scalar],
        h: Scalar,
        smoothing: Scalar | None,
        **at: Any,
    ) -> Solved:
        """Backward Euler of bristles and velocity together, which a quadratic solves exactly at any stiffness.

        z+ = (z + h v+) / (1 + c |v+|),  c = h s0 / F            never leaves +-max(|z|, F / s0)
        (1 + h D / 2) v+ + h S z+ = b,   S = s0 + s1 / h,   b = v + h f_v - h D v / 2 + s1 z
        with r = |v+|, a = 1 + h D / 2, s = sgn(v+) = sgn(b - h S z):
        a c r^2 + (a - s b c + h^2 S) r - |b - h S z| = 0,       of which one root is positive

        Smoothed, the signs of the push and of v+ are x / sqrt(x^2 + smoothing^2).
        """
        (z,) = hidden
        half = 0.5 * h * at["viscous"]
        a = 1.0 + half
        c = h * at["stiffness"] / maximum(at["level"], TINY)
        b = pushed - half * v + at["damping"] * z
        total = h * at["stiffness"] + at["damping"]
        push = b - total * z
        sign = select(push > 0.0, 1.0, -1.0) if smoothing is None else rounded_sign(push, smoothing)
        linear = a - sign * b * c + h * total
        amount = sign * push  # |push|, with its slope at rest too: an optimiser must see how to begin to move
        # The form without cancellation where the linear part is positive, the usual one where it is not.
        root = sqrt(linear * linear + 4.0 * a * c * amount)
        if smoothing is None:
            r = select(
                linear > 0.0, 2.0 * amount / maximum(linear + root, TINY), (root - linear) / maximum(2.0 * a * c, TINY)
            )
            return sign * r, ((z + h * sign * r) / (1.0 + c * r),)
        after = push * select(
            linear > 0.0, 2.0 / maximum(linear + root, TINY), (root - linear) / maximum(2.0 * a * c * amount, TINY)
        )
        speed = after * rounded_sign(after, smoothing)  # none at rest, where bristles must not creep
        return after, ((z + h * after) / (1.0 + c * speed),)
