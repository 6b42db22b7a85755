"""Dry friction that sticks exactly: with a given level, one that grows at rest, or one that acceleration changes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core.friction.contact import TINY, Contact, Field, Fields, Solved, rounded_sign, stefanski
from hybrid_sysid_ros.core.mathematics import Scalar, absolute, maximum, saturate, select

Way = Callable[[Scalar], Scalar]
"""A direction -> 1 + direction against a push upwards, 1 - direction against one downwards."""


@dataclass(frozen=True, kw_only=True)
class _Stick(Contact, ABC):
    """A contact that sticks and slips at a level."""

    creep: Field = 0.0
    """Speed below which the friction is viscous; 0: it sticks exactly."""
    direction: Field = 0.0
    """Share by which the level is higher against a push upwards, and lower against one downwards; within -1 to 1."""
    fields: ClassVar[tuple[str, ...]] = ("viscous", "creep", "direction")

    @abstractmethod
    def level_now(self, v: Scalar, hidden: Sequence[Scalar], smoothing: Scalar | None, at: Fields) -> Scalar:
        """The level during this step, without a direction."""

    def directed(self, v: Scalar, hidden: Sequence[Scalar], way: Way, smoothing: Scalar | None, at: Fields) -> Scalar:
        """The level during this step with its direction, for which ``way`` gives the factor by the sign of the push: at
        rest the velocity has none.
        """
        return way(at.get("direction", 0.0)) * self.level_now(v, hidden, smoothing, at)

    def after(
        self, v: Scalar, following: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Sequence[Scalar]:
        """The hidden states after the step, at whose end the velocity is ``following``."""
        return ()

    def solve(
        self, v: Scalar, pushed: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Solved:
        """Solve z = pushed - h D v / 2;  v+ = (z - sat(z c / (vc (1 + h D / 2) + c), c)) / (1 + h D / 2),   c = h F.

        With vc = 0 and |z| <= h F the velocity is exactly zero: it sticks. Moreau's time stepping for one contact
        (Moreau 1988; Acary & Brogliato 2008, section 1.4.3.4) with a regularised sign. F is that of the sign of z.
        """
        half = 0.5 * h * at["viscous"]
        push = pushed - half * v

        def way(direction: Scalar) -> Scalar:
            if isinstance(direction, float | int):
                if direction == 0.0:
                    return 1.0
                direction = float(direction)
            if smoothing is None:
                return select(push > 0.0, 1.0 + direction, 1.0 - direction)
            return 1.0 + direction * rounded_sign(push, smoothing)

        capacity = h * self.directed(v, hidden, way, smoothing, at)
        # The ratio first: with vc = 0 it is 1 to the last bit, and the velocity 0.
        ratio = capacity / maximum(at["creep"] * (1.0 + half) + capacity, TINY)
        following = (push - saturate(push * ratio, capacity, smoothing)) / (1.0 + half)
        return following, self.after(v, following, hidden, h, smoothing, at)


@dataclass(frozen=True, kw_only=True)
class Dry(_Stick):
    """Dry friction with a given level."""

    level: Field
    fields: ClassVar[tuple[str, ...]] = (*_Stick.fields, "level")

    def level_now(self, v: Scalar, hidden: Sequence[Scalar], smoothing: Scalar | None, at: Fields) -> Scalar:
        return at["level"]


@dataclass(frozen=True, kw_only=True)
class Ageing(Dry):
    """Dry friction whose level grows while it rests and falls while it slides: F + Fe a.

        a' = (1 - a) / T - |v| a / L,  and as a hidden state r = 1 - a: r' = |v| (1 - r) / L - r / T

    a: age of the contact, 0 just made, 1 fully rested; r: the part that sliding has renewed, which is zero where a
    record says nothing about it. At rest the level grows as 1 - exp(-t / T): break-away rises with the time at rest,
    and falls with the rate of the force. Sliding at v, the age settles at 1 / (1 + |v| T / L) over a displacement L,
    which is frictional memory. Source: the ageing law of a contact's state, Dieterich (1979), JGR
    84(B5), Ruina (1983), JGR 88(B12), with a rest that saturates as in Kato, Sato, Matsubayashi (1972), J. Lubrication
    Technology 94(4), exponent 1.
    """

    excess: Field
    """Fe: how much higher the level is at full rest."""
    rest_time: Field
    """T [s]."""
    memory: Field
    """L, the sliding displacement that renews the contact."""
    rest_direction: Field = 0.0
    """Share by which the excess is higher against a push upwards, and lower against one downwards."""
    renewed: str = "renewed"
    """Name of the hidden state."""
    fields: ClassVar[tuple[str, ...]] = (*Dry.fields, "excess", "rest_time", "memory", "rest_direction")

    @property
    def hidden(self) -> tuple[str, ...]:
        return (f"{self.renewed} [1]",)

    def directed(self, v: Scalar, hidden: Sequence[Scalar], way: Way, smoothing: Scalar | None, at: Fields) -> Scalar:
        excess = at["excess"] * (1.0 - hidden[0])
        return way(at.get("direction", 0.0)) * at["level"] + way(at.get("rest_direction", 0.0)) * excess

    def after(
        self, v: Scalar, following: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Sequence[Scalar]:
        """The renewed part by backward Euler, which never leaves 0 to 1."""
        speed = absolute(following) if smoothing is None else following * rounded_sign(following, smoothing)
        rest = h / maximum(at["rest_time"], TINY)
        slid = h * speed / maximum(at["memory"], TINY)
        return ((hidden[0] + slid) / (1.0 + rest + slid),)


@dataclass(frozen=True, kw_only=True)
class Hysteretic(_Stick):
    """Dry friction that is higher while the speed grows than while it falls (``stefanski`` of core.friction).

    The acceleration is that of the previous step, which is a hidden state.
    """

    coulomb: Field
    """Fc."""
    static: Field
    """Fs."""
    speed_shape: Field
    """a1, an acceleration over a speed [1/s]."""
    acceleration_shape: Field
    """a2 [unit of v / s]."""
    acceleration: str = "acceleration"
    """Name of the hidden state."""
    fields: ClassVar[tuple[str, ...]] = (*_Stick.fields, "coulomb", "static", "speed_shape", "acceleration_shape")
    hidden_power: ClassVar[int] = -1

    @property
    def hidden(self) -> tuple[str, ...]:
        return (self.acceleration,)

    def level_now(self, v: Scalar, hidden: Sequence[Scalar], smoothing: Scalar | None, at: Fields) -> Scalar:
        shape = (at["coulomb"], at["static"], at["speed_shape"], at["acceleration_shape"])
        growing = None if smoothing is None else rounded_sign(v, smoothing) * rounded_sign(hidden[0], smoothing)
        return stefanski(v, hidden[0], *shape, growing=growing)

    def after(
        self, v: Scalar, following: Scalar, hidden: Sequence[Scalar], h: Scalar, smoothing: Scalar | None, at: Fields
    ) -> Sequence[Scalar]:
        return ((following - v) / h,)
