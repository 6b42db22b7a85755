"""Maps from one sample to the next."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core.equation import Equation


@dataclass(frozen=True, kw_only=True)
class Recurrence(Equation):
    """x(k + 1) = map(x(k), u(k)), u(k) the mean input over the sample; it holds at its own period only.

    A subclass implements :meth:`~hybrid_sysid_ros.core.equation.Equation.advance`; h is of no meaning to it.
    """

    period: float = 0.05
    """Sampling time [s]."""
