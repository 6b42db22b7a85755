"""Steppers: how a law becomes a step of time. A system names one; it is chosen beside the law."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.friction import Contact, Field
from hybrid_sysid_ros.core.mathematics import Scalar

Rates = Callable[[Sequence[Scalar], Sequence[Scalar]], Sequence[Scalar]]


@dataclass(frozen=True, kw_only=True)
class StepContext:
    """What a stepper is given of a system."""

    rates: Rates
    """(x, u) -> rates of the law's states."""
    contacts: Sequence[Contact]
    field: Callable[[Field | tuple[Field, ...], Sequence[Scalar], Sequence[Scalar]], Any]
    """(field of a contact, x, u) -> its value, or values where it has several."""
    names: Sequence[str]
    """Of all states, those of the contacts last."""
    kinematics: Mapping[int, int] = dataclasses.field(default_factory=dict)
    """Position -> velocity."""


class Stepper(ABC):
    """One step of time."""

    staged: ClassVar[bool] = False
    """Whether the step calls the law several times: then the law is printed once, with :meth:`around` about it."""
    takes_contacts: ClassVar[bool] = False
    is_map: ClassVar[bool] = False
    """Whether the law is not a rate: a position of its own velocity is then not to be found in it."""

    @abstractmethod
    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        """The states a step of h [s] later under inputs that hold. smoothing: of stick-slip, in units of the velocity;
        None: exact.
        """

    def around(self, states: int, columns: int | None) -> str:
        """Source of the ``function`` that calls ``law(x, u, p, w, h, s, out)``, or with ``columns`` of a Jacobian
        ``law(x, u, p, w, h, s, out, jacobian)``; see :mod:`~hybrid_sysid_ros.core.printing`.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class ImplicitFriction(Stepper):
    """Semi-implicit Euler with friction solved implicitly: v+ by the contacts, then q+ = q + h v+.

    Positions follow the new velocities (symplectic Euler for what swings); other states step explicitly.
    """

    takes_contacts = True

    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        declared = x[: len(x) - sum(len(contact.hidden) for contact in context.contacts)]
        following = [a + h * rate for a, rate in zip(declared, context.rates(declared, u), strict=True)]
        hidden: list[Scalar] = []
        for contact in context.contacts:
            index = context.names.index(contact.on)
            at = {name: context.field(getattr(contact, name), declared, u) for name in contact.fields}
            first = len(declared) + len(hidden)
            own = x[first : first + len(contact.hidden)]
            following[index], after = contact.solve(x[index], following[index], own, h, smoothing, **at)
            hidden += after
        for position, velocity in context.kinematics.items():
            following[position] = x[position] + h * following[velocity]
        return [*following, *hidden]


@dataclass(frozen=True)
class Sampled(Stepper):
    """The law is the map from one sample to the next, x(k + 1) = law(x(k), u(k)); it holds at its own period only."""

    is_map = True

    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        return list(context.rates(x, u))
