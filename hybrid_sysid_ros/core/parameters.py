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
    """Bounds, which hold in every fit."""
    start: float
    """Initial value of a fit."""
    spread: float | None = None
    """Standard deviation of a prior around ``start``, for shape parameters that data may not determine."""
    fixed: bool = False
    """Whether it is set from the training data and not fitted."""
    learned: bool = False
    """Whether it is one of many that have a meaning only together: none is reported or doubted by itself."""
    term: str = ""
    """The term of the law that vanishes when the parameter is neutral; "" for none."""
    description: str = ""
    """The docstring under the field."""

    @property
    def scale(self) -> float:
        """A typical change of the parameter, in which a fit scales it."""
        return self.spread or max(abs(self.start), 1e-3 * (self.high - self.low))

    @property
    def neutral(self) -> float:
        """The value that switches the term off: zero where the bounds allow it, else ``start``."""
        return 0.0 if self.low <= 0.0 <= self.high else self.start


def of_data(name: str, unit: str, *, low: float = 0.0) -> Parameter:
    """A parameter that is set from training data and not fitted, such as the scale of a signal."""
    description = "Set from the training data."
    return Parameter(name=name, unit=unit, low=low, high=1e12, start=1.0, fixed=True, description=description)


def scale_of(value: float) -> float:
    """The scale of a signal of a magnitude: the magnitude to four digits, or 1 where it is zero."""
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
    """Declare a field of a system as a parameter, with value, bounds and unit. The docstring under it describes it.

    start: the initial value of a fit, ``value`` by default; see :class:`Parameter` for the others.
    Raises ValueError for a value or a start outside of the bounds.
    """
    begin = value if start is None else start
    if not low <= value <= high or not low <= begin <= high:
        raise ValueError(f"bounded: value {value} or start {begin} is outside [{low}, {high}]")
    options = {"unit": unit, "low": low, "high": high, "start": begin, "spread": spread, "fixed": fixed, "term": term}
    return dataclasses.field(default=value, metadata={"parameter": options})


@cache
def declared(kind: type) -> tuple[Parameter, ...]:
    """The parameters that a dataclass declares, in order. Its source is read once."""
    docstrings = _docstrings(kind)
    return tuple(
        Parameter(name=field.name, description=docstrings.get(field.name, ""), **field.metadata["parameter"])
        for field in dataclasses.fields(kind)
        if "parameter" in field.metadata
    )


def _docstrings(kind: type) -> dict[str, str]:
    """The docstring under each field of a class and its bases, where the source is available."""
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
