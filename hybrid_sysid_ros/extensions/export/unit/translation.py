"""A translation of kernels to C: its functions and types, and how functions of it see what they are given."""

from __future__ import annotations

import ast
import builtins
import inspect
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from types import CodeType, FunctionType
from typing import Any, ClassVar

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.layout import MemoryLayout
from hybrid_sysid_ros.extensions.export.unit.values import (
    LANE,
    REAL,
    ArrayView,
    KnownValue,
    LaneValues,
    NumberValue,
    Origin,
    RecordValue,
    StructureValue,
    TupleValue,
    Value,
    cannot,
    literal,
    number_kind,
)

RESERVED = (
    "init", "reset", "step", "observe", "expected", "judge", "decide", "decide_from", "sent", "at_rest", "lead",
    "come_back", "forget_estimate", "forget_plan", "prepare", "min", "max", "update", "search", "allocate", "release",
    "exchange", "filter", "status", "level", "cause",
)  # fmt: skip
"""What the unit itself has, behind the name of the rig."""


@dataclass(eq=False)
class TranslatedFunction:
    """A translated function."""

    name: str
    about: str
    parameters: list[tuple[str, Any]] = field(default_factory=list)
    """Name in C and value of each parameter that the function reads."""
    order: list[int] = field(default_factory=list)
    """Indices of the arguments that remain."""
    variables: dict[str, Any] = field(default_factory=dict)
    """Name in C and value of each variable that is declared at the top."""
    unused: set[str] = field(default_factory=set)
    """Variables that nothing reads."""
    lines: list[str] = field(default_factory=list)
    result: Any = None
    place: Origin = field(default_factory=lambda: Origin("result"))
    calls: set[str] = field(default_factory=set)
    arrays: set[str] = field(default_factory=set)


class Translation(ABC):
    """What is translated so far. rig: what every name in C begins with. suffix: f for float. constants: values of
    globals that are other ones in C, such as the size of a scratch.
    """

    builtins: ClassVar[dict[Any, Callable[..., Value | None]]]
    """How calls of functions that are no kernels are translated."""

    def __init__(self, layout: MemoryLayout, rig: str, suffix: str, constants: dict[str, Any]) -> None:
        self.layout, self.rig, self.suffix, self.constants = layout, rig, suffix, constants
        self.functions: dict[Any, TranslatedFunction] = {}
        self.structures: dict[str, tuple[tuple[str, str], ...]] = {}
        self.places: list[Origin] = []
        self._names = dict.fromkeys((f"{rig}_{name}" for name in RESERVED), 1)

    @abstractmethod
    def call(self, function: FunctionType, arguments: list[Value]) -> TranslatedFunction:
        """The translation of a function for arguments."""

    def text(self, value: Any) -> str:
        """A known number in C."""
        return literal(value, self.suffix)

    def type_of(self, kind: Any) -> str:
        """The type of an element in C."""
        if isinstance(kind, np.dtype):
            return f"{self.rig}_{self.layout.record(kind)}"
        return f"{self.rig}_real" if kind == REAL else "int"

    def pointer(self, kind: Any, place: Origin) -> str:
        """The type of a pointer in C, to what must not change unless something is written through it: that is known at
        the end, and §k§ is put in its place.
        """
        self.places.append(place)
        return f"§{len(self.places) - 1}§{self.type_of(kind)} *"

    def structure(self, name: str, names: tuple[str, ...], kinds: tuple[str, ...]) -> str:
        """The type of a structure in C."""
        made = f"{self.rig}_{name.lower().strip('_')}"
        own = tuple(zip(names, kinds, strict=True))
        if self.structures.setdefault(made, own) != own:
            return self.structure(f"{name}_more", names, kinds)
        return made

    def _name(self, name: str) -> str:
        base = f"{self.rig}_{name.strip('_').lower()}"
        self._names[base] = count = self._names.get(base, 0) + 1
        return base if count == 1 else f"{base}_{count}"


def tree_of(function: FunctionType) -> ast.FunctionDef:
    """The syntax tree of a function."""
    return _tree(function.__code__)


@cache
def _tree(code: CodeType) -> ast.FunctionDef:
    found = ast.parse(textwrap.dedent(inspect.getsource(code))).body[0]
    assert isinstance(found, ast.FunctionDef)
    return found


def known_names(function: FunctionType) -> dict[str, Any]:
    """Values of the names that a function takes from outside."""
    closure = {
        name: cell.cell_contents
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    }
    return {**vars(builtins), **function.__globals__, **closure}


def python_function(value: Any) -> FunctionType | None:
    """Python's function of one that numba compiles."""
    value = getattr(value, "py_func", value)
    return value if isinstance(value, FunctionType) else None


def parameter(name: str, value: Value) -> Value:
    """How a function sees an argument that is not known."""
    match value:
        case KnownValue(value=number):
            return NumberValue(number_kind(number), name)
        case NumberValue(kind=kind):
            return NumberValue(kind, name)
        case ArrayView(kind=kind, shape=shape):
            return ArrayView(kind, shape, name, Origin(name))
        case RecordValue(kind=kind):
            return RecordValue(kind, name, Origin(name))
        case LaneValues(count=count):
            return LaneValues(count, f"{name}[{LANE}]")
        case StructureValue(type=kind, names=names, kinds=kinds):
            return StructureValue(kind, names, kinds, name)
    raise cannot(f"an argument {value}", name)


def is_known(value: Value) -> bool:
    """Whether an argument is known to a function: then there is a variant of it for that value."""
    if isinstance(value, RecordValue):
        return value.live is not None
    if isinstance(value, TupleValue):
        return all(map(is_known, value.values))
    return isinstance(value, KnownValue) and not isinstance(value.value, float | np.floating | np.ndarray)
