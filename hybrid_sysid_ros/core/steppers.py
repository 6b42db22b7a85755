"""Steppers: methods that make a time step of a law. A system names one beside its law."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.chain_rule import Slopes
from hybrid_sysid_ros.core.friction import Contact, Field
from hybrid_sysid_ros.core.mathematics import Scalar

Rates = Callable[[Sequence[Scalar], Sequence[Scalar]], Sequence[Scalar]]


@dataclass(frozen=True, kw_only=True)
class StepContext:
    """The parts of a system that a stepper reads."""

    rates: Rates
    """(x, u) -> rates of the law's states."""
    contacts: Sequence[Contact]
    field: Callable[[Field | tuple[Field, ...], Sequence[Scalar], Sequence[Scalar]], Any]
    """(field of a contact, x, u) -> its value, or values where it has several."""
    names: Sequence[str]
    """Names of all states; those of the contacts are last."""
    kinematics: Mapping[int, int] = dataclasses.field(default_factory=dict)
    """Position state -> velocity state."""


class Stepper(ABC):
    """A method that makes one time step."""

    staged: ClassVar[bool] = False
    """Whether a step calls the law several times: then the law is printed once, in the loops of :meth:`around`."""
    takes_contacts: ClassVar[bool] = False
    is_map: ClassVar[bool] = False
    """Whether the law gives next states and not rates, so that positions can't be found in it."""

    @abstractmethod
    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        """The states a step of h [s] later under constant inputs. smoothing: velocity over which stick-slip is rounded;
        None: it is exact.
        """

    def around(self, states: int, slopes: Slopes | None) -> str:
        """Source of the ``function`` that calls ``law(x, u, p, w, h, s, out)``, or with the Jacobian of the law of
        ``derive(x, u, p, w, h, s, out, by)``, which calls ``law(x, u, p, w, h, s, out, jacobian)``; see
        :mod:`~hybrid_sysid_ros.core.printing`.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class ImplicitFriction(Stepper):
    """Semi-implicit Euler: the contacts give v+ implicitly, then q+ = q + h v+.

    Positions follow the new velocities (symplectic Euler for oscillations); other states step explicitly.
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
            following[index], after = contact.solve(x[index], following[index], own, h, smoothing, at)
            hidden += after
        for position, velocity in context.kinematics.items():
            following[position] = x[position] + h * following[velocity]
        return [*following, *hidden]


@dataclass(frozen=True)
class Sampled(Stepper):
    """For a law that maps one sample to the next, x(k + 1) = law(x(k), u(k)); it holds only at its own period."""

    is_map = True

    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        return list(context.rates(x, u))
