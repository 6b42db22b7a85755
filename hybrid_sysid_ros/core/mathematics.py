"""Functions for laws: they work on numbers and on the symbols with which a law is traced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from numbers import Real
from typing import Any

import casadi

from hybrid_sysid_ros.support.errors import UserError

Scalar = Any
"""A float, or a casadi.SX while a law is traced."""

sin, cos, tan = casadi.sin, casadi.cos, casadi.tan
asin, acos, atan, atan2 = casadi.asin, casadi.acos, casadi.atan, casadi.atan2
sinh, cosh, tanh = casadi.sinh, casadi.cosh, casadi.tanh
exp, log, sqrt = casadi.exp, casadi.log, casadi.sqrt
hypot, sign, absolute = casadi.hypot, casadi.sign, casadi.fabs
minimum, maximum = casadi.fmin, casadi.fmax


_ROUNDED = ContextVar("_ROUNDED", default=False)


@contextmanager
def rounded(yes: bool = True) -> Iterator[None]:
    """Within this context, corners are rounded over the width ``over`` that a law gives them, for solvers."""
    token = _ROUNDED.set(yes)
    try:
        yield
    finally:
        _ROUNDED.reset(token)


def _magnitude(x: Scalar, over: float) -> Scalar:
    """|x|; rounded: over (3 + 6 t^2 - t^4) / 8 with t = x / over for |t| < 1, twice differentiable at |t| = 1."""
    if not (over and _ROUNDED.get()):
        return casadi.fabs(x)
    squared = (x * (1.0 / over)) ** 2
    return casadi.if_else(squared < 1.0, over * (1.5 - 0.125 * (3.0 - squared) ** 2), casadi.fabs(x))


def sided(x: Scalar, above: Scalar, below: Scalar, *, over: float = 0.0) -> Scalar:
    """Return x above where x > 0 and x below where x < 0; over: width of the corner where it is rounded [unit of x]."""
    return 0.5 * ((above + below) * x + (above - below) * _magnitude(x, over))


def select(condition: Scalar, if_true: Scalar, if_false: Scalar) -> Scalar:
    """One of two values; both are evaluated, and one that is not finite does not spoil the other."""
    return casadi.if_else(condition, if_true, if_false)


def clip(x: Scalar, low: Scalar, high: Scalar, *, over: float = 0.0) -> Scalar:
    """The value limited to low and high; over: width of the corners where they are rounded [unit of x]."""
    if over and _ROUNDED.get():
        if isinstance(low, float) and isinstance(high, float) and high - low >= 2.0 * over:  # the nearer corner is all
            upper = x > 0.5 * (low + high)
            near = casadi.if_else(upper, high, low)
            corner = _magnitude(x - near, over)
            return 0.5 * (x + near + casadi.if_else(upper, -corner, corner))
        return 0.5 * (low + high + _magnitude(x - low, over) - _magnitude(x - high, over))
    return casadi.fmin(casadi.fmax(x, low), high)


def saturate(x: Scalar, limit: Scalar, smoothing: Scalar | None = None) -> Scalar:
    """The value limited to +-limit; ``smoothing`` is the width of its rounded corners, in the unit of x.

    (sqrt((x + L)^2 + s^2) - sqrt((x - L)^2 + s^2)) / 2, which tends to the exact limit as s -> 0.
    """
    if smoothing is None:
        return casadi.fmax(casadi.fmin(x, limit), -limit)
    above, below = x + limit, x - limit
    return 0.5 * (casadi.sqrt(above * above + smoothing**2) - casadi.sqrt(below * below + smoothing**2))


def dead_zone(x: Scalar, width: Scalar, smoothing: Scalar, *, over: float) -> Scalar:
    """What is left of x behind a dead zone of +-width with corners that are rounded by ``smoothing``.

    For solvers it is bridged: within +-over widths it is a x + b x^3, with the value and the slope of the dead zone at
    these ends. Within the zone itself nothing would tell a solver which way leads out, so that it stayed there in
    solutions that cost far more. over: above 1.5, for a slope at 0 that is above 0.
    """
    left = x - saturate(x, width, smoothing)
    if not _ROUNDED.get():
        return left
    end = over * width
    above, below = end + width, end - width
    far, near = casadi.sqrt(above * above + smoothing**2), casadi.sqrt(below * below + smoothing**2)
    mean, slope = 1.0 - 0.5 * (far - near) / end, 1.0 - 0.5 * (above / far - below / near)
    cubic = 0.5 * (slope - mean)
    return casadi.if_else(casadi.fabs(x) < end, x * (mean - cubic + cubic * (x / end) ** 2), left)


def soft_sign(x: Scalar, width: float, *, over: float) -> Scalar:
    """tanh(x / width), a sign that turns round over a width [unit of x], for solvers over ``over``."""
    return casadi.tanh(x / (over if _ROUNDED.get() else width))


def backlash(
    twist: Scalar, rate: Scalar, *, gap: Scalar, stiffness: Scalar, damping: Scalar = 0.0, over: float = 1.5
) -> Scalar:
    """The force of a coupling with a gap: none while the twist is within +-gap / 2, and beyond a spring with a damper
    that push the flanks apart and never pull them together.

    twist: how far the driving side is ahead; rate: the twist's rate of change. For solvers the corners are rounded, and
    the gap is bridged over +-over of its half, see :func:`dead_zone`. The dead-zone model of Nordin and Gutman (2002),
    Controlling mechanical systems with backlash - a survey, Automatica 38(10), with a damper that does not pull.
    """
    half = 0.5 * gap
    if _ROUNDED.get():
        half = maximum(half, 1e-12)  # without a gap the bridge over it would divide zero by zero
        stretch = dead_zone(twist, half, 0.1 * half, over=over)
        return stiffness * stretch + damping * rate * stretch * stretch / (stretch * stretch + half * half)
    stretch = twist - saturate(twist, half)
    push = stiffness * stretch + damping * rate
    return casadi.if_else(
        stretch > 0.0, casadi.fmax(push, 0.0), casadi.if_else(stretch < 0.0, casadi.fmin(push, 0.0), 0.0)
    )


def rows(values: Scalar | Iterable[Scalar], count: int, what: str, of: str) -> list[Scalar]:
    """The values of a sequence or of a CasADi column that ``what`` returns. Raises UserError where they are not
    ``count`` scalars.
    """
    if isinstance(values, casadi.SX):
        found = list(casadi.vertsplit(values))
    else:
        found = list(values) if isinstance(values, Iterable) and not isinstance(values, str | Mapping) else [values]
    if not all(isinstance(item, Real) or (isinstance(item, casadi.SX) and item.is_scalar()) for item in found):
        shown = " ".join(repr(values).split())[:60]
        raise UserError(f"{what} gives {shown}: it needs {count} numbers, or expressions of states and inputs")
    if len(found) != count:
        raise UserError(f"{what} gives {len(found)} values for {count} {of}")
    return found
