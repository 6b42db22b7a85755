"""Bounds of functions over boxes by interval arithmetic, which hold for certain, and whether a box has a point at which
all values are within theirs.

Moore, Kearfott & Cloud (2009), Introduction to interval analysis, SIAM.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np
import scipy

from hybrid_sysid_ros.support.arrays import Array

Sides = tuple[Array, Array]
"""Lowest and highest values, of each box or of one; infinite where nothing is known."""

BOXES, HALVINGS = 20_000, 60
"""Most boxes at a time, and most halvings of one."""

ROUNDING, NEAR = 1e-9, 1e-6
"""By how much a value must be out of its bounds for certain to be so, and to be told as a guess."""


class Nearest(NamedTuple):
    """Where values are nearest to their bounds."""

    beyond: float
    """Largest distance of a value from its bounds there; 0: all are within them."""
    certain: bool
    """Whether nothing is within them for certain; else that is a guess."""


def nearest(function: casadi.Function, rows: Sequence[int], box: Sides, bounds: Sides) -> Nearest:
    """Whether some rows of a function of a vector (entries,) can be within their bounds, (rows,) each, where that is
    within a box, (entries,) each.

    Boxes in which some value is out of its bounds for certain are left out, the others halved across their widest
    side. Where too many are left, a local search (SLSQP) begins at the best centre.
    """
    (low, high), (least, most) = (np.atleast_2d(side) for side in box), bounds
    sides = high - low
    best, beyond = low[0], np.inf
    for _ in range(HALVINGS):
        lowest, highest = (side[:, rows] for side in enclosed(function, (low, high)))
        left = np.all((lowest - most <= ROUNDING) & (least - highest <= ROUNDING), axis=1)
        if not left.any():
            return Nearest(beyond, True)
        low, high = low[left], high[left]
        centres = 0.5 * (low + high)
        values = function(centres.T).full().T[:, rows]
        apart = np.nan_to_num(np.max(np.maximum(values - most, least - values), axis=1), nan=np.inf)
        if apart.min() < beyond:
            best, beyond = centres[np.argmin(apart)], float(apart.min())
        if beyond <= 0.0:
            return Nearest(0.0, False)
        if 2 * len(low) > BOXES:
            break
        across = np.argmax((high - low) / sides, axis=1)[:, None] == np.arange(low.shape[1])
        low, high = np.vstack([low, np.where(across, centres, low)]), np.vstack([np.where(across, centres, high), high])
    beyond = min(beyond, _searched(function, rows, best, box, bounds))
    return Nearest(beyond if beyond > NEAR else 0.0, False)


def _searched(function: casadi.Function, rows: Sequence[int], begin: Array, box: Sides, bounds: Sides) -> float:
    """The least distance t of values from their bounds that a local search finds: min t, bounds - t <= f(u) <= bounds
    + t.
    """
    least, most = bounds

    def room(z: Array) -> Array:
        values = function(z[:-1]).full()[rows, 0]
        return np.concatenate([values - least, most - values])[np.isfinite([*least, *most])] + z[-1]

    first = np.append(begin, 0.0)
    first[-1] = max(0.0, -float(room(first).min()))
    limits = [*zip(*box, strict=True), (0.0, None)]
    constraint = {"type": "ineq", "fun": room}
    found = scipy.optimize.minimize(lambda z: z[-1], first, bounds=limits, constraints=constraint, method="SLSQP")
    within = np.append(np.clip(found.x[:-1], *box), 0.0)
    return max(0.0, -float(room(within).min()))


def enclosed(function: casadi.Function, box: Sides) -> Sides:
    """Bounds (boxes, rows) of a function whose argument is within boxes, (boxes, entries) each."""
    (low, high), work = box, dict[int, Sides]()
    shape = len(low), function.numel_out(0)
    lowest, highest = np.zeros(shape), np.zeros(shape)
    with np.errstate(all="ignore"):
        for k in range(function.n_instructions()):
            operation, of, to = (
                part(k) for part in (function.instruction_id, function.instruction_input, function.instruction_output)
            )
            if operation == casadi.OP_OUTPUT:
                lowest[:, to[1]], highest[:, to[1]] = work[of[0]]
            elif operation == casadi.OP_INPUT:
                work[to[0]] = low[:, of[1]], high[:, of[1]]
            elif operation == casadi.OP_CONST:
                work[to[0]] = (np.full(len(low), function.instruction_constant(k)),) * 2
            else:
                rule = _RULES.get(operation, _unknown)
                least, most = rule(*(work[index] for index in of))
                work[to[0]] = np.where(np.isnan(least), -np.inf, least), np.where(np.isnan(most), np.inf, most)
    return lowest, highest


# ---------------------------------------------------------------------- operations


def _unknown(x: Sides, *_: Sides) -> Sides:
    return np.full_like(x[0], -np.inf), np.full_like(x[0], np.inf)


def _span(*values: Array) -> Sides:
    return np.minimum.reduce(values), np.maximum.reduce(values)


def _ends(function: Any, least: float = -np.inf, most: float = np.inf) -> Callable[[Sides], Sides]:
    """Of a function that rises or falls from least to most. Outside it is no number, and so within no bounds."""
    return lambda x: _span(function(np.clip(x[0], least, most)), function(np.clip(x[1], least, most)))


def _negative(x: Sides) -> Sides:
    return -x[1], -x[0]


def _sum(x: Sides, y: Sides) -> Sides:
    return x[0] + y[0], x[1] + y[1]


def _product(x: Sides, y: Sides) -> Sides:
    return _span(x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1])


def _inverse(x: Sides) -> Sides:
    around = (x[0] <= 0.0) & (x[1] >= 0.0)
    return np.where(around, -np.inf, 1.0 / x[1]), np.where(around, np.inf, 1.0 / x[0])


def _magnitude(x: Sides) -> Sides:
    least, most = _span(np.abs(x[0]), np.abs(x[1]))
    return np.where((x[0] <= 0.0) & (x[1] >= 0.0), 0.0, least), most


def _power(x: Sides, y: Sides) -> Sides:
    exponent = float(y[0][0])
    if np.any(y[0] != exponent) or np.any(y[1] != exponent):
        return _ends(np.exp)(_product(y, _ends(np.log, 0.0)(x)))
    if exponent < 0.0:
        return _inverse(_power(x, _negative(y)))
    raised = _ends(lambda base: base**exponent, -np.inf if exponent % 1.0 == 0.0 else 0.0)
    return raised(_magnitude(x) if exponent % 2.0 == 0.0 else x)


def _sine(x: Sides) -> Sides:
    least, most = _span(np.sin(x[0]), np.sin(x[1]))

    def passes(angle: float) -> Any:
        return np.ceil((x[0] - angle) / (2.0 * np.pi)) * 2.0 * np.pi + angle <= x[1]

    return np.where(passes(-0.5 * np.pi), -1.0, least), np.where(passes(0.5 * np.pi), 1.0, most)


def _cosine(x: Sides) -> Sides:
    return _sine((x[0] + 0.5 * np.pi, x[1] + 0.5 * np.pi))


_RULES: dict[int, Callable[..., Sides]] = {
    **{getattr(casadi, f"OP_{name.upper()}"): _ends(getattr(np, name)) for name in ("exp", "sinh", "tanh")},
    casadi.OP_LOG: _ends(np.log, 0.0),
    casadi.OP_SQRT: _ends(np.sqrt, 0.0),
    casadi.OP_ASIN: _ends(np.arcsin, -1.0, 1.0),
    casadi.OP_ACOS: _ends(np.arccos, -1.0, 1.0),
    casadi.OP_ATAN: _ends(np.arctan),
    casadi.OP_ADD: _sum,
    casadi.OP_SUB: lambda x, y: _sum(x, _negative(y)),
    casadi.OP_MUL: _product,
    casadi.OP_DIV: lambda x, y: _product(x, _inverse(y)),
    casadi.OP_NEG: _negative,
    casadi.OP_INV: _inverse,
    casadi.OP_SQ: lambda x: _ends(np.square)(_magnitude(x)),
    casadi.OP_TWICE: lambda x: (2.0 * x[0], 2.0 * x[1]),
    casadi.OP_POW: _power,
    casadi.OP_CONSTPOW: _power,
    casadi.OP_FABS: _magnitude,
    casadi.OP_SIN: _sine,
    casadi.OP_COS: _cosine,
    casadi.OP_TAN: lambda x: _product(_sine(x), _inverse(_cosine(x))),
    casadi.OP_COSH: lambda x: _ends(np.cosh)(_magnitude(x)),
    casadi.OP_HYPOT: lambda x, y: _ends(np.sqrt)(_sum(*(_ends(np.square)(_magnitude(each)) for each in (x, y)))),
}
