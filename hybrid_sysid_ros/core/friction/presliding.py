"""Friction with presliding displacement: bristles (Dahl and LuGre), and elements of generalised Maxwell slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core.friction.contact import TINY, Contact, Field, Fields, Solved, rounded_sign
from hybrid_sysid_ros.core.mathematics import Scalar, maximum, minimum, saturate, select, sqrt
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Bristles(Contact):
    """Friction of bristles with a stiffness and a damping, up to a level; their deflection is a hidden state.

    A constant level gives Dahl's friction (1968), one that falls with speed the LuGre friction of Canudas de
    Wit et al. (1995), IEEE TAC 40(3), eqs. (1)-(3).
    """

    level: Field
    stiffness: Field
    damping: Field = 0.0
    deflection: str = "deflection"
    """Name of the hidden state; its unit is that of the velocity times s where the name has none."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "level", "stiffness", "damping")

    @property
    def hidden(self) -> tuple[str, ...]:
        return (self.deflection,)

    def solve(
        self, v: Scalar, pushed: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Solved:
        """Backward Euler of bristles and velocity together; a quadratic equation solves it exactly at any stiffness.

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
        amount = sign * push  # |push|, with its derivative at rest: an optimiser must see how motion begins
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
        speed = after * rounded_sign(after, smoothing)  # zero at rest, where bristles must not creep
        return after, ((z + h * after) / (1.0 + c * speed),)


SMOOTH_ITERATIONS = 3
"""Newton steps beyond those that solve the exact form, since rounded corners bend a little on either side."""


@dataclass(frozen=True, kw_only=True)
class MaxwellSlip(Contact):
    """Elements in parallel; each is a spring k_i on a block that slips at its share c_i of the level F(v).

        sticking:  z_i' = v                          until |k_i z_i| = c_i F(v)
        slipping:  k_i z_i' = C sgn(v) (c_i - k_i z_i / F(v))

    Presliding hysteresis then follows Masing's rules, without drift. At speed the friction approaches F(v) at the rate
    C (attraction): where C is small, friction lags behind speed. Source: Al-Bender, Lampaert, Swevers (2005),
    IEEE TAC 50(11), eqs. (9)-(11).

    Raises UserError for elements without stiffness or share, and for shares whose sum is not 1.
    """

    level: Field
    """F."""
    stiffness: tuple[Field, ...]
    """k_i."""
    shares: tuple[float, ...] = ()
    """c_i, shares of the level; equal by default."""
    attraction: Field = 1e12
    """C; where it is large, friction follows F(v) at once."""
    deflection: str = "deflection"
    """Name of the hidden states, which get numbers; their unit is that of the velocity times s."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "level", "stiffness", "attraction")

    def __post_init__(self) -> None:
        count = len(self.stiffness)
        if not self.shares:
            object.__setattr__(self, "shares", (1.0 / max(count, 1),) * count)
        if not count or any(isinstance(k, float | int) and not k > 0.0 for k in self.stiffness):
            raise UserError(f"Maxwell slip on {self.on}: every element needs a stiffness above 0, not {self.stiffness}")
        if len(self.shares) != count or min(self.shares) <= 0.0 or abs(sum(self.shares) - 1.0) > 1e-9:
            raise UserError(
                f"Maxwell slip on {self.on}: {count} elements need as many shares of the level, above 0 and with "
                f"the sum 1, not {self.shares}"
            )

    @property
    def hidden(self) -> tuple[str, ...]:
        name, bracket, unit = self.deflection.partition(" [")
        return tuple(f"{name}_{i + 1}{bracket}{unit}" for i in range(len(self.stiffness)))

    def solve(
        self, v: Scalar, pushed: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Solved:
        """Backward Euler of all elements and the velocity together, exactly.

            (1 + h D / 2) v+ + h sum f_i = b,   f_i = min(k_i z_i + k_i h v+, l_i),   b = v + h f_v - h D v / 2

        for a push b - h sum k_i z_i upwards (for one downwards all signs change); l_i is c_i F, or decays to it after
        the level has fallen. The left side is concave with at most one corner for each element, so Newton's iteration
        from rest reaches the root after at most one step more than there are elements.

        With smoothing, the corners of f_i are rounded over the displacement of the smoothing velocity in a step.
        """
        half = 0.5 * h * at["viscous"]
        stiffness, level = at["stiffness"], maximum(at["level"], TINY)
        forces = [k * z for k, z in zip(stiffness, hidden, strict=True)]
        drive = pushed - half * v
        push = drive - h * sum(forces)
        way = select(push > 0.0, 1.0, -1.0) if smoothing is None else rounded_sign(push, smoothing)
        pace = h * at["attraction"]
        lagging = [(way * f + pace * c) / (1.0 + pace / level) for c, f in zip(self.shares, forces, strict=True)]
        limits = [maximum(c * level, lag) for c, lag in zip(self.shares, lagging, strict=True)]
        turn = way if smoothing is None else 1.0  # rounded limits hold both ways
        rounds = len(stiffness) + 1 + (0 if smoothing is None else SMOOTH_ITERATIONS)
        speed: Scalar = 0.0
        reached: list[Scalar] = []
        for _ in range(rounds + 1):
            ahead = [turn * f + k * h * speed for k, f in zip(stiffness, forces, strict=True)]
            rounding = [None if smoothing is None else k * h * smoothing for k in stiffness]
            held = [_held(*item) for item in zip(ahead, limits, rounding, strict=True)]
            reached = [force for force, _ in held]
            value = (1.0 + half) * speed + h * sum(reached) - turn * drive
            slope = 1.0 + half + h * h * sum(k * rises for k, (_, rises) in zip(stiffness, held, strict=True))
            speed, last = speed - value / slope, speed
        return turn * last, [turn * force / k for k, force in zip(stiffness, reached, strict=True)]


def _held(force: Scalar, limit: Scalar, rounding: Scalar | None) -> tuple[Scalar, Scalar]:
    """A force within a limit, and its derivative."""
    if rounding is None:
        return minimum(force, limit), select(force < limit, 1.0, 0.0)
    above, below = force + limit, force - limit
    far, near = sqrt(above * above + rounding**2), sqrt(below * below + rounding**2)
    return saturate(force, limit, rounding), 0.5 * (above / maximum(far, TINY) - below / maximum(near, TINY))


def fading_stiffnesses(total: Scalar, count: int) -> tuple[Scalar, ...]:
    """Stiffnesses of elements of equal shares that yield one after another, at deflections in the ratio 1 : 2 : ... :
    count, and whose sum is ``total``: k_i = total / (i sum 1 / j).
    """
    parts = sum(1.0 / j for j in range(1, count + 1))
    return tuple(total / (i * parts) for i in range(1, count + 1))
