"""The classical Runge-Kutta step: expressions for CasADi, and loops around a printed law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core.chain_rule import Slopes
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

_JACOBIAN = """@inner
def derive(x, u, p, w, h, s, out, by):
    k, z, total = scratch(ROWS), scratch(ROWS), scratch(ROWS)
    by_k, by_z, summed = scratch(ROWS * COLUMNS), scratch(SEEDS * WIDTH), scratch(ROWS * WIDTH)
    for i in range(ROWS):
        z[i] = x[i]
        total[i] = 0.0
    for i in range(SEEDS * WIDTH):
        by_z[i] = by[i]
    for i in range(ROWS * WIDTH):
        summed[i] = 0.0
    for stage in range(4):
        law(z, u, p, w, h, s, k, by_k)
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range(ROWS):
            total[i] += weight * k[i]
            z[i] = x[i] + ahead * k[i]
        multiply(by_k, by, weight, ahead, by_z, summed)
    for i in range(ROWS):
        out[i] = x[i] + h / 6.0 * total[i]
    for i in range(ROWS * WIDTH):
        by[i] += h / 6.0 * summed[i]
"""

_MULTIPLY = """@inner
def multiply(by_k, by, weight, ahead, by_z, summed):
    for j in range(0, WIDTH, LANES):
        PRODUCTS
"""

_ADDED = """    for i in range(ROWS):
        for j in range(SEEDS, COLUMNS):
            summed[i * WIDTH + j] += weight * by_k[i * COLUMNS + j]
            by_z[i * WIDTH + j] += ahead * by_k[i * COLUMNS + j]
"""


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

    def around(self, states: int, slopes: Slopes | None) -> str:
        """Source around the law. With a Jacobian, each stage has its derivative: dk = law_z dz + law_p."""
        if slopes is None:
            return _VALUE.replace("STATES", str(states))
        use = (
            "store(summed, {0}, plus_scaled(load_numbers(summed, {0}, LANES), c, weight))\n"
            "store(by_z, {0}, plus_scaled(load_numbers(by, {0}, LANES), c, ahead))"
        ).format
        product = _MULTIPLY.replace("PRODUCTS", slopes.products("by_k", "by_z", use))
        product += _ADDED if slopes.columns > slopes.seeds else ""
        return slopes.sized(f"{product}\n\n{_JACOBIAN}")
