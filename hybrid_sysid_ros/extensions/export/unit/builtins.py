"""What kernels call that is no kernel: mathematics, views of memory, printed functions, registers, the solver."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.mpc import quadratic_program
from hybrid_sysid_ros.core import addresses, call, registers
from hybrid_sysid_ros.extensions.export.unit.assignments import FRESH, ZEROS
from hybrid_sysid_ros.extensions.export.unit.body import FunctionBody
from hybrid_sysid_ros.extensions.export.unit.observation_kernels import exchange
from hybrid_sysid_ros.extensions.export.unit.values import (
    BOOL,
    INT,
    LANE,
    PRODUCT,
    REAL,
    SUM,
    ArrayView,
    KnownValue,
    LaneValues,
    NumberValue,
    Origin,
    TupleValue,
    Value,
    bracketed,
    number_kind,
    offset,
)

CallTranslation = Callable[..., Value | None]
AT_ONCE = KnownValue(0)
BUILTINS: dict[Any, CallTranslation] = {}


def _of(*targets: Any) -> Callable[[CallTranslation], CallTranslation]:
    """Decorate the translation of calls of some functions."""

    def keep(function: CallTranslation) -> CallTranslation:
        BUILTINS.update(dict.fromkeys(targets, function))
        return function

    return keep


# ---------------------------------------------------------------------- numbers


def _extreme(name: str, python: Callable[..., Any]) -> CallTranslation:
    """Min or max of several, as numba has them: a NaN that comes first stays."""

    def found(body: FunctionBody, *given: Value) -> Value:
        if all(isinstance(item, KnownValue) for item in given):
            return KnownValue(python(*(item.value for item in given)))  # type: ignore[union-attr]
        real = any(_kind(item) == REAL for item in given)
        total = body.number(given[0], REAL if real else None).text
        called = f"{body.translator.rig}_{name}{'' if real else '_int'}"
        for item in given[1:]:
            total = f"{called}({total}, {body.number(item, REAL if real else None).text})"
        return NumberValue(REAL if real else INT, total)

    return found


BUILTINS[min], BUILTINS[max] = _extreme("min", min), _extreme("max", max)


def _function(name: str) -> CallTranslation:
    def found(body: FunctionBody, *given: Value) -> Value:
        if all(isinstance(item, KnownValue) for item in given):
            return KnownValue(getattr(math, name)(*(item.value for item in given)))  # type: ignore[union-attr]
        texts = ", ".join(body.number(item, REAL).text for item in given)
        return NumberValue(REAL, f"{name}{body.translator.suffix}({texts})")

    return found


for _name in (
    *("exp", "log", "log1p", "expm1", "sqrt", "erf", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh"),
    *("tanh", "asinh", "acosh", "atanh", "atan2", "hypot", "fmod", "copysign"),
):
    BUILTINS[getattr(math, _name)] = _function(_name)


@_of(abs)
def _absolute(body: FunctionBody, given: Value) -> Value:
    if isinstance(given, KnownValue):
        return KnownValue(abs(given.value))
    number = body.number(given)
    if _kind(given) == INT:
        return NumberValue(INT, f"abs({number.text})")
    return NumberValue(REAL, f"fabs{body.translator.suffix}({number.text})")


def _whole(name: str) -> CallTranslation:
    def found(body: FunctionBody, given: Value) -> Value:
        if isinstance(given, KnownValue):
            return KnownValue(getattr(math, name)(given.value))
        return NumberValue(INT, f"(int){name}{body.translator.suffix}({body.number(given, REAL).text})", PRODUCT + 1)

    return found


BUILTINS[math.ceil], BUILTINS[math.floor] = _whole("ceil"), _whole("floor")


@_of(int)
def _truncated(body: FunctionBody, given: Value) -> Value:
    if isinstance(given, KnownValue):
        return KnownValue(int(given.value))
    number = body.number(given)
    return NumberValue(INT, f"(int){bracketed(number, PRODUCT + 1)}", PRODUCT + 1) if _kind(given) == REAL else number


@_of(float)
def _real(body: FunctionBody, given: Value) -> Value:
    return KnownValue(float(given.value)) if isinstance(given, KnownValue) else body.number(given, REAL)


@_of(bool)
def _truth(body: FunctionBody, given: Value) -> Value:
    return body.condition(given)


@_of(len)
def _length(body: FunctionBody, given: Value) -> Value:
    return KnownValue(given.shape[0] if isinstance(given, ArrayView) else len(given.value))  # type: ignore[union-attr]


def _classified(name: str) -> CallTranslation:
    def found(body: FunctionBody, given: Value) -> Value:
        if isinstance(given, KnownValue):
            return KnownValue(getattr(math, name)(given.value))
        return NumberValue(BOOL, f"{name}({body.number(given, REAL).text})")

    return found


BUILTINS[math.isfinite], BUILTINS[math.isnan] = _classified("isfinite"), _classified("isnan")


def _kind(value: Value) -> str:
    if isinstance(value, KnownValue):
        return number_kind(value.value)
    return value.kind if isinstance(value, NumberValue) else REAL


# ---------------------------------------------------------------------- memory


def _sizes(shape: Value) -> tuple[int, ...]:
    parts = shape.values if isinstance(shape, TupleValue) else shape.value  # type: ignore[union-attr]
    parts = parts if isinstance(parts, tuple) else (parts,)
    return tuple(int(item.value if isinstance(item, KnownValue) else item) for item in parts)


BUILTINS[np.empty] = lambda body, shape: ArrayView(REAL, _sizes(shape), "", Origin(FRESH))
BUILTINS[np.zeros] = lambda body, shape: ArrayView(REAL, _sizes(shape), "", Origin(ZEROS))
BUILTINS[np.empty_like] = lambda body, like: ArrayView(REAL, like.shape, "", Origin(FRESH))
BUILTINS[registers.scratch] = lambda body, count: ArrayView(REAL, _sizes(count), "", Origin(FRESH))


def _pointer(body: FunctionBody, array: Value) -> ArrayView:
    view = body.memory_of(array)
    return ArrayView(view.kind, (None,), view.text, view.place, view.level)


BUILTINS[call.pointer] = _pointer


@_of(registers.behind)
def _behind(body: FunctionBody, array: Value, at: Value) -> Value:
    view = body.memory_of(array)
    return offset(view, bracketed(body.number(at), SUM + 1), (None,))


@_of(addresses.numbers_at)
def _numbers_at(body: FunctionBody, address: Value) -> Value:
    return body.translator.layout.at(address.value)  # type: ignore[union-attr]


@_of(addresses.vector)
def _vector(body: FunctionBody, address: Value, length: Value, first: Value = AT_ONCE) -> Value:
    return offset(_numbers_at(body, address), bracketed(body.number(first), SUM + 1), _sizes(length))  # type: ignore[arg-type]


@_of(addresses.matrix)
def _matrix(body: FunctionBody, address: Value, rows: Value, columns: Value, first: Value = AT_ONCE) -> Value:
    shape = (*_sizes(rows), *_sizes(columns))
    return offset(_numbers_at(body, address), bracketed(body.number(first), SUM + 1), shape)  # type: ignore[arg-type]


# ---------------------------------------------------------------------- printed functions


@_of(call.call_value, call.call_jacobian)
def _by_address(body: FunctionBody, address: Value, *given: Value) -> Value | None:
    function = body.translator.layout.function(address.value)  # type: ignore[union-attr]
    arguments: list[Value] = []
    for item in given:
        if isinstance(item, ArrayView) or (isinstance(item, KnownValue) and isinstance(item.value, np.ndarray)):
            arguments.append(_pointer(body, item))
        else:
            number: Any = item
            arguments.append(body.number(number, REAL))
    return body.apply(function, arguments)


@_of(registers.select)
def _select(body: FunctionBody, test: Value, number: Value, other: Value) -> Value:
    truth = body.condition(test)
    if isinstance(truth, KnownValue):
        return number if truth.value else other
    return body.either(truth, number, other)


# ---------------------------------------------------------------------- the solver of quadratic programs


@_of(quadratic_program._update)
def _update(body: FunctionBody, function: Value, changed: Value, workspace: Value, problem: Value) -> Value:
    body.made.calls.add("unit")
    number = body.number(changed).text
    return NumberValue(INT, f"{body.translator.rig}_update($unit$, {number})")


@_of(quadratic_program._solve)
def _solve(body: FunctionBody, function: Value, result: Value, workspace: Value) -> Value:
    body.made.calls.add("unit")
    return NumberValue(INT, f"{body.translator.rig}_search($unit$)")


@_of(exchange)
def _exchange(body: FunctionBody, loop: Value, which: Value) -> None:
    body.made.calls.add("unit")
    body.line(f"{body.translator.rig}_exchange($unit$, {body.number(which).text});")


# ---------------------------------------------------------------------- registers


@_of(registers.load_numbers)
def _load(body: FunctionBody, memory: Value, at: Value, lanes: Value) -> Value:
    view = body.memory_of(memory)
    return LaneValues(lanes.value, f"{bracketed(view, 9)}[{bracketed(body.number(at), SUM)} + {LANE}]")  # type: ignore[union-attr]


@_of(registers.store)
def _store(body: FunctionBody, memory: Value, at: Value, register: Value) -> None:
    view = body.memory_of(memory)
    view.place.write()
    assert isinstance(register, LaneValues)
    body.on_lanes(
        register.count, f"{bracketed(view, 9)}[{bracketed(body.number(at), SUM)} + {LANE}] = {register.text};"
    )


@_of(registers.zero)
def _zero(body: FunctionBody, lanes: Value) -> Value:
    return LaneValues(lanes.value, body.translator.text(0.0))  # type: ignore[union-attr]


@_of(registers.plus_scaled)
def _plus_scaled(body: FunctionBody, total: Value, register: Value, factor: Value) -> Value:
    assert isinstance(total, LaneValues)
    assert isinstance(register, LaneValues)
    scale = bracketed(body.number(factor, REAL), PRODUCT + 1)
    text = f"{bracketed(total, SUM)} + {bracketed(register, PRODUCT)} * {scale}"
    return LaneValues(total.count, text, SUM)


@_of(registers.added)
def _added(body: FunctionBody, one: Value, two: Value) -> Value:
    assert isinstance(one, LaneValues)
    assert isinstance(two, LaneValues)
    return LaneValues(one.count, f"{bracketed(one, SUM)} + {bracketed(two, SUM + 1)}", SUM)


@_of(registers.tanh)
def _tanh(body: FunctionBody, register: Value) -> Value:
    assert isinstance(register, LaneValues)
    return LaneValues(register.count, f"tanh{body.translator.suffix}({register.text})")
