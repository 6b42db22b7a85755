"""Physical parameters, declared beside the law that uses them."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One named number of a system."""

    name: str
    unit: str
    low: float
    high: float
    """Bounds that hold in every fit."""
    start: float
    """Where a fit begins."""
    spread: float | None = None
    """Standard deviation of a prior about ``start``, for shape parameters that data may leave undetermined."""
    fixed: bool = False
    """Set from the range of the training data, not fitted."""
    learned: bool = False
    """One of many that mean something together only: no single one is told, and none is doubted."""
    term: str = ""
    """The part of the law that goes when the parameter is neutral, "" for none."""
    description: str = ""
    """The docstring under the field."""

    @property
    def scale(self) -> float:
        """A typical change of the parameter: the unit in which a fit measures it."""
        return self.spread or max(abs(self.start), 1e-3 * (self.high - self.low))

    @property
    def neutral(self) -> float:
        """The value that switches its term off: zero where that is allowed."""
        return 0.0 if self.low <= 0.0 <= self.high else self.start


def of_data(name: str, unit: str, *, low: float = 0.0) -> Parameter:
    """A parameter that training data set and no fit moves, such as the scale of a signal."""
    description = "Of the training data."
    return Parameter(name=name, unit=unit, low=low, high=1e12, start=1.0, fixed=True, description=description)


def scale_of(value: float) -> float:
    """The scale of a signal of a magnitude: four digits of it, 1 where it is zero."""
    return float(f"{value:.4g}") or 1.0


def bounded(
    value: float,
    low: float,
    high: float,
    *,
    unit: str,
    start: float | None = None,
    spread: float | None = None,
    fixed: bool = False,
    term: str = "",
) -> Any:
    """Declare a field of a system as a parameter: its value, bounds and unit. The docstring under it says what it is.

    start: where a fit begins, the value by default; see :class:`Parameter` for the others.
    Raises ValueError for a value or a start outside of the bounds.
    """
    begin = value if start is None else start
    if not low <= value <= high or not low <= begin <= high:
        raise ValueError(f"bounded: value {value} or start {begin} is outside [{low}, {high}]")
    options = {"unit": unit, "low": low, "high": high, "start": begin, "spread": spread, "fixed": fixed, "term": term}
    return dataclasses.field(default=value, metadata={"parameter": options})


@cache
def declared(kind: type) -> tuple[Parameter, ...]:
    """The parameters that a dataclass declares, in order; read from its source once."""
    docstrings = _docstrings(kind)
    return tuple(
        Parameter(name=field.name, description=docstrings.get(field.name, ""), **field.metadata["parameter"])
        for field in dataclasses.fields(kind)
        if "parameter" in field.metadata
    )


def _docstrings(kind: type) -> dict[str, str]:
    """The docstring under each field of a class and its bases, where the source is there."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        except (OSError, TypeError, SyntaxError, ValueError):
            continue
        body = getattr(tree, "body", [])
        for field, after in pairwise(body):
            named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
            if named and isinstance(text, str):
                found[field.target.id] = " ".join(text.split())
    return found
