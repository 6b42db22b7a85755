"""Values of a translation: what is known when a unit is printed, and what is an expression in C."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.support.errors import UserError

ATOM, PRODUCT, SUM, ORDER, EQUAL, AND, OR, CHOICE = 9, 7, 6, 5, 4, 3, 2, 1
"""How tightly an expression holds together."""

LANE = "#"
"""What stands for the index of one of several numbers side by side."""

REAL, INT, BOOL = "real", "int", "bool"
"""Kinds of numbers. In C the first is float or double, and the others are int."""


@dataclass(eq=False)
class Origin:
    """Memory that pointers lead to, or a pointer: what is written through a pointer is written to all it came from."""

    name: str
    sources: set[Origin] = field(default_factory=set)
    written: bool = False

    def write(self) -> None:
        """Mark it as written, and all that it came from."""
        if not self.written:
            self.written = True
            for source in self.sources:
                source.write()

    def take(self, source: Origin) -> None:
        """Point to where another one points, too."""
        self.sources.add(source)
        if self.written:
            source.write()


@dataclass(frozen=True)
class KnownValue:
    """A value that is known when the unit is printed: a number, a function, an object of Python's loop."""

    value: Any


@dataclass(frozen=True)
class NumberValue:
    """A number that is known when the unit runs."""

    kind: str
    text: str
    level: int = ATOM


@dataclass(frozen=True)
class ArrayView:
    """An array, or a part of one. kind: of its elements, or the type of a record. shape: None in place of a length that
    nobody needs. text: a pointer to its first element.
    """

    kind: str | np.dtype[Any]
    shape: tuple[int | None, ...]
    text: str
    place: Origin
    level: int = ATOM
    live: Any = None
    """Python's own array, where the view is all of it."""


@dataclass(frozen=True)
class RecordValue:
    """One record. live: Python's own, where there is one such record; its members that nothing writes are known."""

    kind: np.dtype[Any]
    text: str
    place: Origin
    live: Any = None

    def member(self, name: str) -> str:
        """A member of it in C; ``text`` is an element of an array, or a pointer's name."""
        return f"{self.text}{'.' if self.text.endswith(']') else '->'}{name}"


@dataclass(frozen=True)
class TupleValue:
    """Values side by side. names: of a named tuple's members."""

    values: tuple[Any, ...]
    names: tuple[str, ...] = ()
    of: str = ""


@dataclass(frozen=True)
class StructureValue:
    """A structure in C of numbers, which a function returned."""

    type: str
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    text: str

    def number(self, name: str) -> NumberValue:
        """A member of it."""
        return NumberValue(self.kinds[self.names.index(name)], f"{self.text}.{name}")


@dataclass(frozen=True)
class LaneValues:
    """Several numbers that are computed side by side, by a text for one of them, in which LANE stands for its index."""

    count: int
    text: str
    level: int = ATOM


Value = KnownValue | NumberValue | ArrayView | RecordValue | TupleValue | StructureValue | LaneValues


def bracketed(value: NumberValue | ArrayView | LaneValues, least: int) -> str:
    """The text of a value as an operand of what holds its parts together by ``least``."""
    return value.text if value.level >= least else f"({value.text})"


def number_kind(value: Any) -> str:
    """The kind of a known number."""
    if isinstance(value, bool | np.bool_):
        return BOOL
    return INT if isinstance(value, int | np.integer) else REAL


def literal(value: Any, suffix: str) -> str:
    """A known number in C. suffix: of its constants, f for float."""
    if isinstance(value, bool | np.bool_ | int | np.integer):
        return str(int(value))
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return f"{float(value)!r}{suffix}"


def offset(view: ArrayView, text: str, shape: tuple[int | None, ...]) -> ArrayView:
    """The part of a view from an index on."""
    moved = view.text if text == "0" else f"{bracketed(view, SUM)} + {text}"
    return replace(view, text=moved, shape=shape, level=view.level if text == "0" else SUM, live=None)


def cannot(what: str, where: str) -> UserError:
    """The error of something that has no translation."""
    return UserError(f"export: {what} in {where} can't be printed as C")
