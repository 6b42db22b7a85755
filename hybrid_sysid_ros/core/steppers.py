"""Steppers: how a law becomes a step of time. A system names one; it is chosen beside the equations."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core.contacts import Contact, Field
from hybrid_sysid_ros.core.mathematics import Scalar

Rates = Callable[[Sequence[Scalar], Sequence[Scalar]], Sequence[Scalar]]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What a stepper is given of a system."""

    rates: Rates
    """(x, u) -> rates of the law's states."""
    contacts: Sequence[Contact]
    field: Callable[[Field, Sequence[Scalar], Sequence[Scalar]], Scalar]
    """(field of a contact, x, u) -> its value."""
    names: Sequence[str]
    """Of all states, deflections last."""
    kinematics: Mapping[int, int] = dataclasses.field(default_factory=dict)
    """Position -> velocity."""


class Stepper(ABC):
    """One step of time."""

    stages: str = ""
    """Source of loops around the printed function, for steppers that call the law several times; "": the whole step is
    printed. See :mod:`~hybrid_sysid_ros.core.printing`.
    """

    @abstractmethod
    def advance(
        self, motion: Motion, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        """The states a step of h [s] later under inputs that hold. smoothing: of stick-slip, in units of the velocity;
        None: exact.
        """

    @property
    def takes_contacts(self) -> bool:
        return False


@dataclass(frozen=True)
class ImplicitFriction(Stepper):
    """Semi-implicit Euler with friction solved implicitly: v+ by the contacts, then q+ = q + h v+.

    Positions follow the new velocities (symplectic Euler for what swings); other states step explicitly.
    """

    def advance(
        self, motion: Motion, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        declared = x[: len(x) - sum(contact.state is not None for contact in motion.contacts)]
        following = [a + h * rate for a, rate in zip(declared, motion.rates(declared, u), strict=True)]
        hidden: list[Scalar] = []
        for contact in motion.contacts:
            index = motion.names.index(contact.on)
            at = {name: motion.field(getattr(contact, name), declared, u) for name in contact.fields}
            z = x[len(declared) + len(hidden)] if contact.state is not None else None
            following[index], after = contact.solve(x[index], following[index], z, h, smoothing, **at)
            if contact.state is not None:
                hidden.append(after)
        for position, velocity in motion.kinematics.items():
            following[position] = x[position] + h * following[velocity]
        return [*following, *hidden]

    @property
    def takes_contacts(self) -> bool:
        return True


@dataclass(frozen=True)
class RungeKutta(Stepper):
    """The classical method of order four, for systems without contacts.

    Kutta (1901); Hairer, Norsett, Wanner (1993), Solving ODEs I, table II.1.2.
    """

    stages = "runge_kutta"

    def advance(
        self, motion: Motion, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        def moved(rates: Sequence[Scalar], share: float) -> list[Scalar]:
            return [a + share * h * rate for a, rate in zip(x, rates, strict=True)]

        k1 = motion.rates(x, u)
        k2 = motion.rates(moved(k1, 0.5), u)
        k3 = motion.rates(moved(k2, 0.5), u)
        k4 = motion.rates(moved(k3, 1.0), u)
        return moved([(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)], 1.0)


@dataclass(frozen=True)
class Sampled(Stepper):
    """The law is the map from one sample to the next, x(k + 1) = law(x(k), u(k)); it holds at its own period only."""

    def advance(
        self, motion: Motion, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        return list(motion.rates(x, u))
