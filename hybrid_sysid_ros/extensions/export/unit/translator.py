"""Translation of kernels to C: of each function a variant for the sizes and known values with which it is called.

Kernels are written in the subset of Python that numba compiles without objects. Sizes, switches and functions among
their arguments are known when a unit is printed, so the C has plain pointers, literal sizes, and no branch that a
switch excludes.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.body import FunctionBody
from hybrid_sysid_ros.extensions.export.unit.builtins import BUILTINS
from hybrid_sysid_ros.extensions.export.unit.translation import TranslatedFunction, Translation
from hybrid_sysid_ros.extensions.export.unit.values import (
    REAL,
    ArrayView,
    KnownValue,
    LaneValues,
    NumberValue,
    RecordValue,
    StructureValue,
    TupleValue,
    Value,
    cannot,
)


class Translator(Translation):
    """Translates entry points and all that they call."""

    builtins = BUILTINS

    def call(self, function: FunctionType, arguments: list[Value]) -> TranslatedFunction:
        key = (function.__code__, _cells(function), tuple(_key(item) for item in arguments))
        if key not in self.functions:
            made = TranslatedFunction(self._name(function.__name__), _about(function))
            FunctionBody(self, function, made).translate(arguments)
            self.functions[key] = made
        return self.functions[key]


def _key(value: Value) -> Any:
    match value:
        case KnownValue(value=float() | np.floating()):
            return REAL
        case KnownValue(value=bool() | int() | np.integer() | np.bool_() | None as number):
            return type(number), number
        case KnownValue(value=thing):
            return _identity(thing)
        case RecordValue(live=live, kind=kind):
            return ("item", kind.names) if live is None else _identity(np.asarray(live))
        case NumberValue(kind=kind):
            return kind
        case ArrayView(kind=kind, shape=shape):
            return getattr(kind, "names", kind), shape
        case LaneValues(count=count):
            return "lanes", count
        case TupleValue(values=values):
            return tuple(map(_key, values))
        case StructureValue(type=kind):
            return kind
    raise cannot(f"an argument {value}", "a call")


def _cells(function: FunctionType) -> Any:
    return _identity(tuple(cell.cell_contents for cell in function.__closure__ or ()))


def _identity(thing: Any) -> Any:
    """What a thing is known by. Views and tuples are made anew wherever they are asked for, and the next one may lie
    where the last one lay: they are known by what they hold.
    """
    match thing:
        case np.ndarray():
            return thing.ctypes.data, thing.shape, thing.dtype.names
        case tuple():
            return tuple(map(_identity, thing))
        case int() | float() | str() | None:
            return type(thing), thing
    return id(thing)


def _about(function: FunctionType) -> str:
    """The first sentence of a function's docstring."""
    text = " ".join((function.__doc__ or "").split())
    text = text.partition(". ")[0].rstrip(".:")
    return text.replace(":func:", "").replace("`", "").replace("~", "").replace("*/", "")
