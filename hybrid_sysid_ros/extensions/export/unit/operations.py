"""Operations on values of a kernel, in C or, where all is known, in Python."""

from __future__ import annotations

import ast
import operator
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.translation import TranslatedFunction, Translation
from hybrid_sysid_ros.extensions.export.unit.values import (
    AND,
    ATOM,
    BOOL,
    CHOICE,
    EQUAL,
    INT,
    OR,
    ORDER,
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
    cannot,
    number_kind,
)


class _Operator(NamedTuple):
    python: Any
    text: str
    level: int


_BINARY: dict[type, _Operator] = {
    ast.Add: _Operator(operator.add, "+", SUM),
    ast.Sub: _Operator(operator.sub, "-", SUM),
    ast.Mult: _Operator(operator.mul, "*", PRODUCT),
    ast.Div: _Operator(operator.truediv, "/", PRODUCT),
    ast.FloorDiv: _Operator(operator.floordiv, "/", PRODUCT),
    ast.Mod: _Operator(operator.mod, "%", PRODUCT),
    ast.BitOr: _Operator(operator.or_, "|", EQUAL - 1),
    ast.BitAnd: _Operator(operator.and_, "&", EQUAL - 1),
}
_COMPARED: dict[type, _Operator] = {
    ast.Lt: _Operator(operator.lt, "<", ORDER),
    ast.LtE: _Operator(operator.le, "<=", ORDER),
    ast.Gt: _Operator(operator.gt, ">", ORDER),
    ast.GtE: _Operator(operator.ge, ">=", ORDER),
    ast.Eq: _Operator(operator.eq, "==", EQUAL),
    ast.NotEq: _Operator(operator.ne, "!=", EQUAL),
    ast.Is: _Operator(operator.is_, "==", EQUAL),
    ast.IsNot: _Operator(operator.is_not, "!=", EQUAL),
}


class Operations:
    """Operations on the values of a function."""

    translator: Translation
    made: TranslatedFunction
    function: Any
    names: dict[str, Any]
    """What the function takes from outside."""
    values: dict[str, Value]
    """Values of the function's own names."""

    @property
    def where(self) -> str:
        """The function in errors."""
        return f"{self.function.__module__.rpartition('.')[2]}.{self.function.__name__}"

    # ------------------------------------------------------------------ numbers

    def number(self, value: Value, kind: str | None = None) -> NumberValue | LaneValues:
        """A value as a number in C, of a kind if one is given."""
        match value:
            case KnownValue(value=bool() | np.bool_() | int() | np.integer() | float() | np.floating() as given):
                own = kind or number_kind(given)
                text = self.translator.text(float(given) if own == REAL else given)
                found: NumberValue | LaneValues = NumberValue(own, text, PRODUCT if text.startswith("-") else ATOM)
            case NumberValue() | LaneValues():
                found = value
            case _:
                raise cannot(f"the value {value} as a number", self.where)
        if isinstance(found, NumberValue) and kind == REAL and found.kind != REAL:
            return NumberValue(REAL, f"({self.translator.rig}_real){bracketed(found, ATOM)}", PRODUCT + 1)
        return found

    def condition(self, value: Value) -> KnownValue | NumberValue:
        """A value as a truth."""
        if isinstance(value, KnownValue):
            return KnownValue(bool(value.value))
        found = self.number(value)
        assert isinstance(found, NumberValue)
        return found if found.kind == BOOL else NumberValue(BOOL, f"{bracketed(found, EQUAL + 1)} != 0", EQUAL)

    def binary(self, op: ast.operator, left: Value, right: Value) -> Value:
        """An operation on two values."""
        if isinstance(left, KnownValue) and isinstance(right, KnownValue):
            if isinstance(op, ast.Pow):
                return KnownValue(left.value**right.value)
            return KnownValue(_BINARY[type(op)].python(left.value, right.value))
        if isinstance(op, ast.Pow):
            both = [self.number(item, REAL) for item in (left, right)]
            return NumberValue(REAL, f"pow{self.translator.suffix}({both[0].text}, {both[1].text})")
        how = _BINARY[type(op)]
        a, b = self.number(left), self.number(right)
        real = isinstance(op, ast.Div) or REAL in (kind_in(a), kind_in(b))
        if real:
            a, b = self.number(left, REAL), self.number(right, REAL)
        elif 0 in (getattr(left, "value", None), getattr(right, "value", None)):  # indices
            if isinstance(op, ast.Mult):
                return KnownValue(0)
            if isinstance(op, ast.Add):
                return b if getattr(left, "value", None) == 0 else a
        elif isinstance(op, ast.Mult) and getattr(left, "value", None) == 1:
            return b
        elif isinstance(op, ast.Mult) and getattr(right, "value", None) == 1:
            return a
        text = f"{bracketed(a, how.level)} {how.text} {bracketed(b, how.level + 1)}"
        return NumberValue(REAL if real else INT, text, how.level)

    def unary(self, op: ast.unaryop, operand: Value) -> Value:
        if isinstance(operand, KnownValue):
            return KnownValue(not operand.value if isinstance(op, ast.Not) else -operand.value)
        if isinstance(op, ast.Not):
            truth = self.condition(operand)
            assert isinstance(truth, NumberValue)
            return NumberValue(BOOL, f"!{bracketed(truth, ATOM)}", PRODUCT + 1)
        given = self.number(operand)
        return NumberValue(kind_in(given), f"-{bracketed(given, PRODUCT)}", SUM)

    def pair(self, op: ast.cmpop, left: Value, right: Value) -> Value:
        if isinstance(op, ast.In) and isinstance(right, TupleValue):
            pairs = [self.number(self.pair(ast.Eq(), left, item)) for item in right.values]
            return NumberValue(BOOL, " || ".join(bracketed(item, AND + 1) for item in pairs), OR)
        how = _COMPARED[type(op)]
        if isinstance(left, KnownValue) and isinstance(right, KnownValue):
            return KnownValue(bool(how.python(left.value, right.value)))
        kinds = {kind_in(self.number(left)), kind_in(self.number(right))}
        a, b = (self.number(item, REAL if REAL in kinds else None) for item in (left, right))
        return NumberValue(BOOL, f"{bracketed(a, how.level + 1)} {how.text} {bracketed(b, how.level + 1)}", how.level)

    def either(self, truth: NumberValue, one: Value, two: Value) -> Value:
        """One of two values by a test."""
        if isinstance(one, ArrayView) and isinstance(two, ArrayView):
            place = Origin("choice")
            place.take(one.place)
            place.take(two.place)
            text = f"{bracketed(truth, CHOICE + 1)} ? {bracketed(one, CHOICE + 1)} : {bracketed(two, CHOICE + 1)}"
            shape = one.shape if one.shape == two.shape else (None,)
            return ArrayView(one.kind, shape, text, place, CHOICE)
        kinds = [kind_in(self.number(item)) for item in (one, two)]
        kind = REAL if REAL in kinds else kinds[0] if kinds[0] == kinds[1] else INT
        a, b = (self.number(item, kind) for item in (one, two))
        text = f"{bracketed(truth, CHOICE + 1)} ? {bracketed(a, CHOICE + 1)} : {bracketed(b, CHOICE + 1)}"
        if isinstance(a, LaneValues) or isinstance(b, LaneValues):
            return LaneValues(a.count if isinstance(a, LaneValues) else b.count, text, CHOICE)  # type: ignore[union-attr]
        return NumberValue(kind, text, CHOICE)


def is_constant(array: Any) -> bool:
    """Whether an array is one of indices or switches, which no kernel writes."""
    return array.dtype.kind in "ib" and array.dtype.itemsize != 4


def kind_in(value: NumberValue | LaneValues) -> str:
    """The kind of a number."""
    return value.kind if isinstance(value, NumberValue) else REAL
