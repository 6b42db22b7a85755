"""The arrays of a loop as members of one structure in C, or as constants where nothing writes them."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import fields
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.extensions.export.unit.values import BOOL, INT, REAL, ArrayView, Origin, cannot
from hybrid_sysid_ros.support.arrays import Array


class MemoryLayout:
    """The arrays that kernels may reach, by their names and by their addresses."""

    def __init__(self, records: list[tuple[np.dtype[Any], str]]) -> None:
        """records: types of records, and their names in C."""
        self.records = records
        self.arrays: dict[str, NDArray[Any]] = {}
        self.places: dict[str, Origin] = {}
        self.used: set[str] = set()
        """Names of the arrays that translated code reads or writes."""
        self.mutable: dict[str, set[str]] = {}
        """Members, by the name of a record's type, of single records that are written."""
        self.complete = True
        """Whether no such member was found on the way, which earlier functions took as known."""
        self._names: dict[int, str] = {}
        self._functions = _printed_functions()

    def add(self, name: str, value: Any) -> None:
        """Give names to the arrays of an object: arrays, data classes of them, mappings and tuples."""
        if isinstance(value, np.ndarray):
            root = _root(value)
            if root.size and root.ctypes.data not in self._names:
                self._names[root.ctypes.data] = name
                self.arrays[name], self.places[name] = root, Origin(name)
        elif isinstance(value, Shared):
            for item in fields(value):  # type: ignore[arg-type]
                self.add(f"{name}_{item.name}", getattr(value, item.name))
        elif isinstance(value, Mapping):
            for key, part in value.items():
                self.add(f"{name}_{key}", part)
        elif hasattr(value, "_asdict"):
            self.add(name, value._asdict())

    def record(self, kind: np.dtype[Any]) -> str:
        """The name of a record's type."""
        found = next((name for known, name in self.records if known is kind or known == kind), None)
        if found is None:
            raise cannot("a record without a name", "the loop")
        return found

    def change(self, kind: np.dtype[Any], member: str) -> None:
        """Note that a member of a single record is written."""
        changed = self.mutable.setdefault(self.record(kind), set())
        self.complete = self.complete and member in changed
        changed.add(member)

    def changes(self, kind: np.dtype[Any], member: str) -> bool:
        """Whether a member of a single record is written."""
        return member in self.mutable.get(self.record(kind), ())

    def view(self, array: Array) -> ArrayView:
        """An array, or a part of one, in C. One that is not the loop's is a constant of a function, as of a block."""
        root, kind = _root(array), element(array.dtype)
        if not array.size:
            return ArrayView(kind, array.shape, "0", Origin("nothing"), live=array)
        if root.ctypes.data not in self._names:
            self.add(f"constant_{len(self.arrays)}", root)
        name = self._names[root.ctypes.data]
        self.used.add(name)
        first = (array.ctypes.data - root.ctypes.data) // root.itemsize
        text = f"@{name}@" if not first else f"(@{name}@ + {first})"
        return ArrayView(kind, array.shape, text, self.places[name], live=array)

    def at(self, address: int) -> ArrayView:
        """The numbers at an address."""
        name = self._names.get(address)
        if name is None:
            return ArrayView(REAL, (None,), "0", Origin("nothing"))  # an array without elements
        self.used.add(name)
        return ArrayView(element(self.arrays[name].dtype), (None,), f"@{name}@", self.places[name])

    def function(self, address: int) -> FunctionType:
        """The printed function at an address."""
        if address not in self._functions:
            raise cannot("a function without a printed source", "the loop")
        return self._functions[address]


def element(kind: np.dtype[Any]) -> str | np.dtype[Any]:
    """The kind of an array's elements."""
    if kind.names:
        return kind
    return {"f": REAL, "i": INT, "b": BOOL}[kind.kind]


def members(kind: np.dtype[Any]) -> dict[str, str]:
    """Names and kinds of a record's members."""
    return {name: str(element(kind[name])) for name in kind.names or ()}


def _root(array: Array) -> Array:
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _printed_functions() -> dict[int, FunctionType]:
    """Python's function by the address of each printed one that this process has loaded."""
    found = (module for name, module in list(sys.modules.items()) if re.fullmatch(r"printed_[0-9a-f]+", name))
    return {int(module.function.address): module.function._pyfunc for module in found}
