"""Expressions of a kernel in C, with all that is known already computed."""

from __future__ import annotations

import ast
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.extensions.export.unit.layout import members
from hybrid_sysid_ros.extensions.export.unit.operations import Operations, is_constant
from hybrid_sysid_ros.extensions.export.unit.translation import TranslatedFunction, python_function
from hybrid_sysid_ros.extensions.export.unit.values import (
    AND,
    ATOM,
    BOOL,
    OR,
    SUM,
    ArrayView,
    KnownValue,
    LaneValues,
    NumberValue,
    RecordValue,
    StructureValue,
    TupleValue,
    Value,
    bracketed,
    cannot,
    offset,
)

NOTHING = "0"
"""What stands for an element that there is not."""


class Expressions(Operations):
    """Evaluates expressions of a function."""

    # ------------------------------------------------------------------ expressions

    def value(self, node: ast.expr) -> Value:
        """The value of an expression."""
        match node:
            case ast.Constant(value=value):
                return KnownValue(value)
            case ast.Name(id=name):
                return self._named(name)
            case ast.Attribute(value=of, attr=name):
                return self._attribute(self.value(of), name)
            case ast.Subscript(value=of, slice=index):
                return self.element(self.value(of), index)
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(op, self.value(left), self.value(right))
            case ast.UnaryOp(op=op, operand=operand):
                return self.unary(op, self.value(operand))
            case ast.BoolOp(op=op, values=values):
                return self._truths(isinstance(op, ast.And), values)
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compared([left, *others], ops)
            case ast.IfExp(test=test, body=body, orelse=other):
                return self._choice(test, body, other)
            case ast.Tuple(elts=parts):
                return TupleValue(tuple(self.value(part) for part in parts))
            case ast.Call():
                found = self.call(node)
                if found is None:
                    raise cannot(f"a value of {ast.unparse(node)}", self.where)
                return found
        raise cannot(ast.unparse(node), self.where)

    def _named(self, name: str) -> Value:
        if name in self.values:
            return self.values[name]
        if name in self.names:
            return KnownValue(self.translator.constants.get(name, self.names[name]))
        raise cannot(f"the name {name}", self.where)

    def _attribute(self, of: Value, name: str) -> Value:
        match of:
            case KnownValue(value=Shared() | ModuleType() | tuple() as thing):
                return self.known(getattr(thing, name))
            case KnownValue(value=np.ndarray() as array) if name in ("shape", "size", "ndim"):
                return KnownValue(getattr(array, name))
            case ArrayView(shape=shape):
                if name == "shape":
                    return KnownValue(shape)
                if name == "size" and None not in shape:
                    return KnownValue(int(np.prod(shape)))  # type: ignore[arg-type]
            case RecordValue(kind=kind, live=live):
                own = members(kind)
                if live is not None and not self.translator.layout.changes(kind, name):
                    return KnownValue(live[name].item())
                return NumberValue(own[name], of.member(name))
            case StructureValue():
                return of.number(name)
            case TupleValue(values=values, names=names) if name in names:
                return values[names.index(name)]
        raise cannot(f"the attribute {name}", self.where)

    def known(self, value: Any) -> Value:
        """A value of Python's loop; arrays that may change are views."""
        if isinstance(value, np.ndarray) and not is_constant(value):
            return self.translator.layout.view(value)
        return KnownValue(value)

    def _truths(self, every: bool, nodes: list[ast.expr]) -> Value:
        parts: list[NumberValue] = []
        for node in nodes:
            truth = self.condition(self.value(node))
            if isinstance(truth, NumberValue):
                parts.append(truth)
            elif truth.value is not every:
                if not parts:
                    return truth
                parts.append(NumberValue(BOOL, self.translator.text(truth.value)))
                break
        if not parts:
            return KnownValue(every)
        if len(parts) == 1:
            return parts[0]
        level, sign = (AND, " && ") if every else (OR, " || ")
        return NumberValue(BOOL, sign.join(bracketed(part, level if every else AND + 1) for part in parts), level)

    def _compared(self, nodes: list[ast.expr], ops: list[ast.cmpop]) -> Value:
        values = [self.value(node) for node in nodes]
        if len(ops) == 1:
            return self.pair(ops[0], *values)
        pairs = [self.pair(op, *values[k : k + 2]) for k, op in enumerate(ops)]
        texts = [self.number(pair) for pair in pairs]
        return NumberValue(BOOL, " && ".join(bracketed(text, AND + 1) for text in texts), AND)

    def _choice(self, test: ast.expr, body: ast.expr, other: ast.expr) -> Value:
        truth = self.condition(self.value(test))
        if isinstance(truth, KnownValue):
            return self.value(body if truth.value else other)
        return self.either(truth, self.value(body), self.value(other))

    # ------------------------------------------------------------------ elements

    def element(self, of: Value, index: ast.expr) -> Value:
        """An element, a row or a slice of a value."""
        if isinstance(index, ast.Slice):
            return self._slice(of, index)
        if isinstance(index, ast.Tuple) and isinstance(last := index.elts[-1], ast.Slice):
            return self._slice(self.element(of, ast.Tuple(index.elts[:-1], ast.Load())), last)
        given = [self.value(part) for part in (index.elts if isinstance(index, ast.Tuple) else [index])]
        match of:
            case KnownValue(value=value) if all(isinstance(item, KnownValue) for item in given):
                places = tuple(item.value for item in given)  # type: ignore[union-attr]
                return self._item(value, places)
            case KnownValue(value=np.ndarray() as array):
                of = self.translator.layout.view(array)
            case TupleValue(values=values):
                assert isinstance(given[0], KnownValue)
                return values[given[0].value]
        if not isinstance(of, ArrayView):
            raise cannot(f"an element of {of}", self.where)
        return self.part(of, given)

    def _item(self, value: Any, places: tuple[int, ...]) -> Value:
        found = value[places if isinstance(value, np.ndarray) else places[0]]
        if isinstance(value, np.ndarray) and value.dtype.names and isinstance(found, np.void):
            view = self.translator.layout.view(value)
            return RecordValue(value.dtype, f"{view.text}[{places[0]}]", view.place, live=found)
        return KnownValue(found.item()) if isinstance(found, np.generic) else self.known(found)

    def part(self, of: ArrayView, given: list[Value]) -> Value:
        """An element or a row of a view; 0 for an element of an array without any, which no call ever reaches."""
        if 0 in of.shape and len(given) == len(of.shape) and isinstance(of.kind, str):
            return NumberValue(of.kind, NOTHING)
        at: Value = KnownValue(0)
        for axis, index in enumerate(given):
            length = of.shape[axis]
            if isinstance(index, KnownValue) and index.value < 0:
                index = KnownValue(index.value + length)
            at = index if axis == 0 else self.binary(ast.Add(), self.binary(ast.Mult(), at, KnownValue(length)), index)
        rest = of.shape[len(given) :]
        if rest:
            for length in rest:
                at = self.binary(ast.Mult(), at, KnownValue(length))
            return offset(of, bracketed(self.number(at), SUM + 1), rest)
        text = f"{bracketed(of, ATOM)}[{self.number(at).text}]"
        if isinstance(of.kind, str):
            return NumberValue(of.kind, text)
        live = of.live
        single = live is not None and live.size == 1 and isinstance(at, KnownValue)
        return RecordValue(of.kind, text, of.place, live=live.reshape(-1)[0] if single else None)

    def _slice(self, of: Value, index: ast.Slice) -> Value:
        ends = [None if node is None else self.value(node) for node in (index.lower, index.upper)]
        bounds = [item.value if isinstance(item, KnownValue) else item for item in ends]
        if any(isinstance(item, NumberValue) for item in bounds):
            raise cannot("a slice with ends that are not known", self.where)
        if isinstance(of, KnownValue):
            return KnownValue(of.value[slice(*bounds)])
        if not isinstance(of, ArrayView) or of.shape[0] is None:
            raise cannot(f"a slice of {of}", self.where)
        begin, end, _ = slice(*bounds).indices(of.shape[0])
        at: Value = KnownValue(begin)
        for length in of.shape[1:]:
            at = self.binary(ast.Mult(), at, KnownValue(length))
        return offset(of, self.number(at).text, (max(end - begin, 0), *of.shape[1:]))

    # ------------------------------------------------------------------ calls

    def call(self, node: ast.Call) -> Value | None:
        """The value of a call; None where there is none."""
        if isinstance(node.func, ast.Attribute) and node.func.attr in ("any", "reshape"):
            of = self.value(node.func.value)
            if node.func.attr == "any" and isinstance(of, KnownValue):
                return KnownValue(bool(of.value.any()))
            if isinstance(of, ArrayView):
                (shape,) = (self.value(item) for item in node.args)
                parts = shape.values if isinstance(shape, TupleValue) else (shape,)
                return ArrayView(of.kind, tuple(item.value for item in parts), of.text, of.place, of.level)  # type: ignore[union-attr]
        target = self.value(node.func)
        if not isinstance(target, KnownValue):
            raise cannot(ast.unparse(node.func), self.where)
        arguments = [self.value(item) for item in node.args]
        if node.keywords:
            raise cannot(f"keywords of {ast.unparse(node.func)}", self.where)
        return self.apply(target.value, arguments)

    def apply(self, target: Any, arguments: list[Value]) -> Value | None:
        """The value of a function for arguments."""
        builtin = self.translator.builtins.get(_hashable(target))
        if builtin is not None:
            return builtin(self, *arguments)
        if isinstance(target, type) and issubclass(target, tuple):
            return TupleValue(tuple(arguments), target._fields, target.__name__)  # type: ignore[attr-defined]
        function = python_function(target)
        if function is None:
            raise cannot(f"a call of {getattr(target, '__name__', target)}", self.where)
        if all(isinstance(item, KnownValue) and isinstance(item.value, int) for item in arguments):
            return KnownValue(function(*(item.value for item in arguments)))  # type: ignore[union-attr]
        return self._called(function, arguments)

    def _called(self, function: FunctionType, arguments: list[Value]) -> Value | None:
        missing = function.__code__.co_argcount - len(arguments)
        if missing > 0:
            arguments = [*arguments, *(KnownValue(item) for item in (function.__defaults__ or ())[-missing:])]
        arguments = [self.known(item.value) if isinstance(item, KnownValue) else item for item in arguments]
        made = self.translator.call(function, arguments)
        texts = []
        for index, (_, own) in zip(made.order, made.parameters, strict=True):
            given = arguments[index]
            match own:
                case NumberValue(kind=kind):
                    texts.append(self.number(given, kind).text)
                case ArrayView(place=place):
                    source = self.memory_of(given)
                    place.take(source.place)
                    texts.append(source.text)
                case RecordValue(place=place):
                    assert isinstance(given, RecordValue)
                    place.take(given.place)
                    texts.append(f"&{given.text}" if given.text.endswith("]") else given.text)
                case LaneValues():
                    texts.append(self.memory_of(given).text)
                case StructureValue():
                    texts.append(given.text)  # type: ignore[union-attr]
        return self.result_of(made, texts)

    def result_of(self, made: TranslatedFunction, texts: list[str]) -> Value | None:
        """The value of a call of a translated function."""
        self.made.calls.add(made.name)
        text = f"{made.name}(${made.name}${', ' if texts else ''}{', '.join(texts)})"
        match made.result:
            case NumberValue(kind=kind):
                return NumberValue(kind, text)
            case ArrayView(kind=kind, shape=shape):
                return ArrayView(kind, shape, text, made.place)
            case StructureValue(type=kind, names=names, kinds=kinds):
                return self.kept(StructureValue(kind, names, kinds, text))
            case LaneValues(count=count):
                return self.lanes_of(made, texts, count)
        self.line(f"{text};")
        return None

    # what a body does

    def line(self, text: str) -> None:
        """Write a line."""
        raise NotImplementedError

    def kept(self, value: StructureValue) -> StructureValue:
        """A structure in a variable of its own."""
        raise NotImplementedError

    def memory_of(self, value: Value) -> ArrayView:
        """A view of numbers, which are written to memory if they are not in it."""
        raise NotImplementedError

    def lanes_of(self, made: TranslatedFunction, texts: list[str], count: int) -> LaneValues:
        """The lanes that a function writes."""
        raise NotImplementedError


def _hashable(target: Any) -> Any:
    try:
        hash(target)
    except TypeError:
        return id(target)
    return target
