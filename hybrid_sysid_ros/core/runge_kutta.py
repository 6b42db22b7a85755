"""The classical Runge-Kutta step: expressions for CasADi, and loops around a printed law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.steppers import StepContext, Stepper

_VALUE = """@compiled(VALUE)
def function(x, u, p, w, h, s, out):
    k, z, total = scratch(STATES), scratch(STATES), scratch(STATES)
    for i in range(STATES):
        z[i] = x[i]
        total[i] = 0.0
    for stage in range(4):
        law(z, u, p, w, h, s, k)
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range(STATES):
            total[i] += weight * k[i]
            z[i] = x[i] + ahead * k[i]
    for i in range(STATES):
        out[i] = x[i] + h / 6.0 * total[i]
"""

_JACOBIAN = """@compiled(JACOBIAN)
def function(x, u, p, w, h, s, out, jacobian):
    k, z, total = scratch(STATES), scratch(STATES), scratch(STATES)
    by_k, by_z = scratch(ALL), scratch(ALL)
    for i in range(STATES):
        z[i] = x[i]
        total[i] = 0.0
    for i in range(ALL):
        by_z[i] = 0.0
        jacobian[i] = 0.0
    for i in range(STATES):
        by_z[i * COLUMNS + i] = 1.0
    for stage in range(4):
        law(z, u, p, w, h, s, k, by_k)
        for i in range(STATES):
            own = scratch(STATES)
            for l in range(STATES):
                own[l] = by_k[i * COLUMNS + l]
                by_k[i * COLUMNS + l] = 0.0
            for l in range(STATES):
                slope = own[l]
                for j in range(PASSED):
                    by_k[i * COLUMNS + j] += slope * by_z[l * COLUMNS + j]
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range(STATES):
            total[i] += weight * k[i]
            z[i] = x[i] + ahead * k[i]
        for i in range(ALL):
            jacobian[i] += weight * by_k[i]
            by_z[i] = ahead * by_k[i]
        for i in range(STATES):
            by_z[i * COLUMNS + i] += 1.0
    for i in range(STATES):
        out[i] = x[i] + h / 6.0 * total[i]
    for i in range(ALL):
        jacobian[i] *= h / 6.0
    for i in range(STATES):
        jacobian[i * COLUMNS + i] += 1.0
"""


MANY = 8
"""States from which on zeros of a law's derivative are passed over: with fewer, looking for them takes longer."""


@dataclass(frozen=True)
class RungeKutta(Stepper):
    """The classical method of fourth order, for systems without contacts.

    Kutta (1901); Hairer, Norsett, Wanner (1993), Solving ODEs I, table II.1.2.
    """

    staged = True

    def advance(
        self, context: StepContext, x: Sequence[Scalar], u: Sequence[Scalar], h: Scalar, smoothing: Scalar | None
    ) -> list[Scalar]:
        def moved(rates: Sequence[Scalar], share: float) -> list[Scalar]:
            return [a + share * h * rate for a, rate in zip(x, rates, strict=True)]

        k1 = context.rates(x, u)
        k2 = context.rates(moved(k1, 0.5), u)
        k3 = context.rates(moved(k2, 0.5), u)
        k4 = context.rates(moved(k3, 1.0), u)
        return moved([(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)], 1.0)

    def around(self, states: int, columns: int | None) -> str:
        """Source around the law. With a Jacobian, each stage has its derivative: dk = law_z dz + law_p."""
        n = str(states)
        if columns is None:
            return _VALUE.replace("STATES", n)
        passed = _JACOBIAN.replace("PASSED", "COLUMNS if slope != 0.0 else 0" if states >= MANY else "COLUMNS")
        return passed.replace("STATES", n).replace("COLUMNS", str(columns)).replace("ALL", str(states * columns))
