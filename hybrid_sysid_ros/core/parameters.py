"""Physical parameters, declared beside the equation that uses them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One named number of an equation.

    low, high: bounds that hold in every fit. start: where a fit begins. spread: standard deviation of a prior about
    ``start`` for shape parameters that data may leave undetermined (None: no prior). fixed: set from the range of the
    training data, not fitted. term: the part of the equation that goes when the parameter is neutral, "" for none.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    spread: float | None
    fixed: bool
    term: str
    description: str

    @property
    def scale(self) -> float:
        """A typical change of the parameter: the unit in which a fit measures it."""
        return self.spread or max(abs(self.start), 1e-3 * (self.high - self.low))

    @property
    def neutral(self) -> float:
        """The value that switches its term off: zero where that is allowed."""
        return 0.0 if self.low <= 0.0 <= self.high else self.start


def parameter(
    value: float,
    low: float,
    high: float,
    *,
    unit: str,
    description: str,
    start: float | None = None,
    spread: float | None = None,
    fixed: bool = False,
    term: str = "",
) -> Any:
    """Declare a dataclass field as a parameter: its value, bounds, unit and meaning in one place."""
    begin = value if start is None else start
    if not low <= value <= high or not low <= begin <= high:
        raise ValueError(f"{description}: value {value} or start {begin} is outside [{low}, {high}]")
    metadata = {
        "unit": unit,
        "low": low,
        "high": high,
        "start": begin,
        "spread": spread,
        "fixed": fixed,
        "term": term,
        "description": description,
    }
    return dataclasses.field(default=value, metadata={"parameter": metadata})


def declared(kind: type) -> tuple[Parameter, ...]:
    """The parameters that a dataclass declares, in order."""
    return tuple(
        Parameter(name=field.name, **field.metadata["parameter"])
        for field in dataclasses.fields(kind)
        if "parameter" in field.metadata
    )
