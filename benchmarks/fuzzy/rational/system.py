"""The plant by which nonlinear identification is compared since 1990: rational in its output, linear in its input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import Recurrence, bounded
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Rational(Recurrence):
    """y(k + 1) = y(k) / (1 + y(k)^2) + g u(k), as Narendra and Parthasarathy (1990), IEEE Trans. NN 1(1), have it."""

    states = ("level [1]",)
    inputs = ("drive [1]",)

    gain: float = bounded(1.0, 0.1, 10.0, unit="1")
    """G."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return (x[0] / (1.0 + x[0] * x[0]) + self.gain * u[0],)
