"""What every contact is, and the plainest one: viscous friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.mathematics import Scalar, maximum, sqrt

Field = str | float | Callable[[Any, Any, Any], Any]

TINY = 1e-12
"""Keeps 0 / 0 out of the step of a frictionless instant."""

Solved = tuple[Scalar, Sequence[Scalar]]
"""Velocity and hidden states after a step."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Friction on one velocity."""

    on: str
    """Name of the velocity that carries it."""
    viscous: Field = 0.0
    """D, resolved trapezoidally."""
    fields: ClassVar[tuple[str, ...]] = ("viscous",)
    hidden_power: ClassVar[int] = 1
    """Power of s in the unit of hidden states over that of the velocity: 1 is a way, -1 an acceleration."""

    @property
    def hidden(self) -> tuple[str, ...]:
        """The hidden states that the contact brings along, as declarations."""
        return ()

    def solve(
        self,
        v: Scalar,
        pushed: Scalar,
        hidden: Sequence[Scalar],
        h: Scalar,
        smoothing: Scalar | None,
        **at: Any,
    ) -> Solved:
        """Velocity and hidden states after a step of h [s]: ``pushed`` is v + h f_v, ``at`` the fields' values.

        Viscous friction is trapezoidal: second order, where Euler's damping depends on the step.
        """
        half = 0.5 * h * at["viscous"]
        return (pushed - half * v) / (1.0 + half), ()


@dataclass(frozen=True, kw_only=True)
class Viscous(Contact):
    """Friction in proportion to the velocity."""


def rounded_sign(x: Scalar, smoothing: Scalar) -> Scalar:
    """X / sqrt(x^2 + smoothing^2)."""
    return x / maximum(sqrt(x * x + smoothing * smoothing), TINY)
