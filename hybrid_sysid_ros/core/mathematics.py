"""The mathematics of a law: works on numbers and on the symbols with which a law is traced."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi

Scalar = Any
"""A float, or a casadi.SX while a law is traced."""

sin, cos, tan = casadi.sin, casadi.cos, casadi.tan
asin, acos, atan, atan2 = casadi.asin, casadi.acos, casadi.atan, casadi.atan2
sinh, cosh, tanh = casadi.sinh, casadi.cosh, casadi.tanh
exp, log, sqrt = casadi.exp, casadi.log, casadi.sqrt
hypot, sign, absolute = casadi.hypot, casadi.sign, casadi.fabs
minimum, maximum = casadi.fmin, casadi.fmax


def select(condition: Scalar, if_true: Scalar, if_false: Scalar) -> Scalar:
    """The one or the other; both are evaluated, and where one is not finite the other still counts."""
    return casadi.if_else(condition, if_true, if_false)


def clip(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """The value within low and high."""
    return casadi.fmin(casadi.fmax(x, low), high)


def saturate(x: Scalar, limit: Scalar, smoothing: Scalar | None = None) -> Scalar:
    """The value within +-limit; with ``smoothing`` its corners are rounded over that much, in the unit of x.

    (sqrt((x + L)^2 + s^2) - sqrt((x - L)^2 + s^2)) / 2, which tends to the exact one as s -> 0.
    """
    if smoothing is None:
        return casadi.fmax(casadi.fmin(x, limit), -limit)
    above, below = x + limit, x - limit
    return 0.5 * (casadi.sqrt(above * above + smoothing**2) - casadi.sqrt(below * below + smoothing**2))


def rows(values: Scalar | Sequence[Scalar]) -> list[Scalar]:
    """The values of a sequence, or of a column as CasADi has it."""
    return list(casadi.vertsplit(values)) if isinstance(values, casadi.SX) else list(values)
