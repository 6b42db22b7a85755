"""Assignments of a kernel in C, and its variables."""

from __future__ import annotations

import ast
from dataclasses import replace
from types import FunctionType
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.expressions import Expressions
from hybrid_sysid_ros.extensions.export.unit.names import counts_of, safe, used_where_made, variables_of
from hybrid_sysid_ros.extensions.export.unit.translation import (
    TranslatedFunction,
    Translation,
    known_names,
    tree_of,
)
from hybrid_sysid_ros.extensions.export.unit.values import (
    ATOM,
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
)

LARGEST = 64
"""Numbers that a function keeps on the stack at most; longer arrays are in the unit's memory."""

FRESH, ZEROS = "fresh", "fresh zeros"
"""Places of arrays that a function makes."""


class Assignments(Expressions):
    """Sets what a function sets."""

    def __init__(self, translator: Translation, function: FunctionType, made: TranslatedFunction) -> None:
        self.translator, self.made = translator, made
        self.function = function
        self.tree = tree_of(function)
        self.names = known_names(function)
        self.values: dict[str, Value] = {}
        self.counts, self._inside = counts_of(self.tree), used_where_made(self.tree)
        self.depth, self._temporaries = 1, 0
        self.ended = False
        self.read: set[str] = set()
        self.made_here: dict[str, int] = {}
        """Line of each variable that is declared where it is set."""

    def assign(self, target: ast.expr, value: Value) -> None:
        match target:
            case ast.Name(id="_"):
                pass
            case ast.Name(id=name):
                self.bind(name, value)
            case ast.Tuple(elts=targets):
                self._unpack(targets, value)
            case ast.Attribute(value=of, attr=attribute):
                self.line(f"{self._member(of, attribute).text} = {self._as(self._member(of, attribute), value)};")
            case ast.Subscript(value=of, slice=index):
                self._store(of, index, value)

    def _unpack(self, targets: list[ast.expr], value: Value) -> None:
        match value:
            case TupleValue(values=parts):
                values = list(parts)
            case KnownValue(value=known):
                values = [self.known(item.item() if isinstance(item, np.generic) else item) for item in known]
            case StructureValue(names=names):
                values = [value.number(name) for name in names]
            case ArrayView(shape=shape):
                values = [self.part(value, [KnownValue(k)]) for k in range(shape[0] or 0)]
            case _:
                raise cannot(f"unpacking {value}", self.where)
        own = {safe(item.id) for item in targets if isinstance(item, ast.Name)}
        if any(own & variables_of(getattr(item, "text", "")) for item in values[1:]):
            values = [self.temporary("kept", item) for item in values]
        for target, item in zip(targets, values, strict=True):
            self.assign(target, item)

    def bind(self, name: str, value: Value) -> None:
        value = self.known(value.value) if isinstance(value, KnownValue) else value
        if isinstance(value, ArrayView) and value.place.name in (FRESH, ZEROS):
            if self.counts[name] == 1:
                self.values[name] = self._array(name, value)
                return
            value = self._array(f"{name}_memory", value)
        if self.counts[name] > 1:
            self.set_variable(name, value)
        elif isinstance(value, KnownValue | TupleValue | StructureValue) or (
            isinstance(value, ArrayView | RecordValue) and not self._moves(value.text)
        ):
            self.values[name] = value
        elif name in self._inside:
            self._declare(name, value)
        else:
            self.set_variable(name, value)

    def _declare(self, name: str, value: Value) -> None:
        """Declare a variable where it is set, once."""
        own = safe(name)
        self.made_here[own] = len(self.made.lines)
        match value:
            case NumberValue(kind=kind):
                self.line(f"const {self._type(kind)} {own} = {value.text};")
                self.values[name] = NumberValue(kind, own)
            case LaneValues(count=count):
                self.on_lanes(count, f"const {self._type(REAL)} {own}{LANE} = {value.text};")
                self.values[name] = LaneValues(count, f"{own}{LANE}")
            case ArrayView() | RecordValue():
                place = Origin(own)
                place.take(value.place)
                text = f"&{value.text}" if isinstance(value, RecordValue) and value.text.endswith("]") else value.text
                self.line(f"{self._pointer(value.kind, place)}const {own} = {text};")
                own_value = replace(value, text=own, place=place)
                self.values[name] = replace(own_value, level=ATOM) if isinstance(own_value, ArrayView) else own_value

    def set_variable(self, name: str, value: Value) -> None:
        """Set a variable that is declared at the top, or a parameter."""
        own, before = safe(name), self.values.get(name)
        if isinstance(before, KnownValue | TupleValue):
            before = None
        match value:
            case KnownValue() | NumberValue():
                number = self.number(value)
                assert isinstance(number, NumberValue)
                if not isinstance(before, NumberValue):
                    before = NumberValue(number.kind, own)
                    self.made.variables[own] = before
                elif before.kind != REAL and number.kind == REAL:
                    raise cannot(f"the variable {name}, which is whole and is not", self.where)
                self.line(f"{own} = {self.number(value, before.kind).text};")
                self.values[name] = before
            case ArrayView() | RecordValue():
                if not isinstance(before, ArrayView | RecordValue):
                    before = replace(value, text=own, place=Origin(own))
                    if isinstance(before, ArrayView):
                        before = replace(before, level=ATOM, live=None)
                    self.made.variables[own] = before
                elif isinstance(before, ArrayView) and isinstance(value, ArrayView) and before.shape != value.shape:
                    before = replace(before, shape=(None,))
                before.place.take(value.place)
                self.line(f"{own} = {value.text};")
                self.values[name] = before
            case StructureValue():
                if not isinstance(before, StructureValue):
                    before = replace(value, text=own)
                    self.made.variables[own] = before
                self.line(f"{own} = {value.text};")
                self.values[name] = before
            case LaneValues(count=count):
                if not isinstance(before, LaneValues):
                    before = LaneValues(count, f"{own}{LANE}")
                    self.made.variables[own] = before
                self.on_lanes(count, f"{before.text} = {value.text};")
                self.values[name] = before
            case _:
                raise cannot(f"the variable {name}", self.where)

    def _array(self, name: str, value: ArrayView) -> ArrayView:
        """An array that a function makes: on the stack, or, where it is long, in the unit's memory."""
        size, own = int(np.prod(value.shape)), safe(name)  # type: ignore[arg-type]
        if size == 0:
            return replace(value, text="0", place=Origin("nothing"))
        if size > LARGEST:
            whole = f"{self.made.name.partition('_')[2]}_{own}"
            layout = self.translator.layout
            layout.add(whole, np.zeros(size))
            layout.used.add(whole)
            layout.places[whole].write()
            view = replace(value, text=f"@{whole}@", place=layout.places[whole])
        else:
            view = replace(value, text=own, place=Origin(own))
            self.made.variables[own] = replace(view, shape=(size,))
        if value.place.name == ZEROS:
            turn = self.fresh("turn")
            self.line(f"for (int {turn} = 0; {turn} < {size}; {turn}++) {view.text}[{turn}] = 0;")
        return view

    def _member(self, of: ast.expr, name: str) -> NumberValue:
        item = self.value(of)
        if not isinstance(item, RecordValue):
            raise cannot(f"setting {name} of {ast.unparse(of)}", self.where)
        if item.live is not None:
            self.translator.layout.change(item.kind, name)
        item.place.write()
        found = self._attribute(item, name)
        assert isinstance(found, NumberValue)
        return found

    def _store(self, of: ast.expr, index: ast.expr, value: Value) -> None:
        view = self.value(of)
        if isinstance(view, LaneValues):
            raise cannot("storing to lanes", self.where)
        target = self.element(view, index)
        assert isinstance(view, ArrayView)
        view.place.write()
        match target:
            case NumberValue(text="0"):
                pass  # an array without elements
            case NumberValue():
                self.line(f"{target.text} = {self._as(target, value)};")
            case RecordValue() if isinstance(value, RecordValue):
                self.line(f"{target.text} = {value.text};")
            case _:
                raise cannot(f"storing to {ast.unparse(of)}", self.where)

    def _change(self, target: ast.expr, op: ast.operator, node: ast.expr) -> None:
        signs = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitOr: "|", ast.BitAnd: "&"}
        sign, value = signs[type(op)], self.value(node)
        if isinstance(target, ast.Attribute):
            found: Value = self._member(target.value, target.attr)
        elif isinstance(target, ast.Subscript):
            view = self.value(target.value)
            found = self.element(view, target.slice)
            assert isinstance(view, ArrayView)
            view.place.write()
        else:
            assert isinstance(target, ast.Name)
            found = self.value(target)
        if isinstance(found, LaneValues):
            raise cannot("changing lanes", self.where)
        assert isinstance(found, NumberValue)
        self.line(f"{found.text} {sign}= {self._as(found, value)};")

    # ------------------------------------------------------------------ pieces

    def _as(self, target: NumberValue, value: Value) -> str:
        found = self.number(value, REAL if target.kind == REAL else None)
        if isinstance(found, NumberValue) and found.kind == REAL and target.kind != REAL:
            raise cannot(f"storing a number to the whole number {target.text}", self.where)
        return found.text

    def _named(self, name: str) -> Value:
        self.read.add(safe(name))
        return super()._named(name)

    def _moves(self, text: str) -> bool:
        """Whether a text may mean something else later: it has a variable, or a call."""
        fixed = {own.text for own in self.values.values() if isinstance(own, ArrayView) and self._is_fixed(own)}
        return "$" in text or bool(variables_of(text) - fixed)

    def _is_fixed(self, view: ArrayView) -> bool:
        name = next((key for key, value in self.values.items() if value is view), "")
        return self.counts[name] <= 1

    def on_lanes(self, count: int, text: str) -> None:
        """A line for each of several numbers: an array of them would go through memory."""
        for lane in range(count):
            self.line(text.replace(LANE, str(lane)))

    def fresh(self, name: str) -> str:
        self._temporaries += 1
        return f"{name}{self._temporaries}"

    def temporary(self, name: str, value: Any) -> Any:
        """A value in a variable of its own."""
        if isinstance(value, KnownValue):
            return value
        own = self.fresh(name)
        if isinstance(value, NumberValue):
            self.line(f"const {self._type(value.kind)} {own} = {value.text};")
            return NumberValue(value.kind, own)
        if isinstance(value, ArrayView):
            place = Origin(own)
            place.take(value.place)
            self.line(f"{self._pointer(value.kind, place)}const {own} = {value.text};")
            return replace(value, text=own, level=ATOM, place=place)
        raise cannot(f"keeping {value}", self.where)

    def _type(self, kind: str) -> str:
        return f"{self.translator.rig}_real" if kind == REAL else "int"

    def _pointer(self, kind: Any, place: Origin) -> str:
        return self.translator.pointer(kind, place)

    def line(self, text: str) -> None:
        self.made.lines.append("    " * self.depth + text)

    def kept(self, value: StructureValue) -> StructureValue:
        own = self.fresh("made")
        self.line(f"const {value.type} {own} = {value.text};")
        return replace(value, text=own)

    def memory_of(self, value: Value) -> ArrayView:
        if isinstance(value, ArrayView):
            return value
        if isinstance(value, KnownValue) and isinstance(value.value, np.ndarray):
            return self.translator.layout.view(value.value)
        assert isinstance(value, LaneValues)
        own = self.fresh("lanes")
        self.made.variables[own] = view = ArrayView(REAL, (value.count,), own, Origin(own))
        self.on_lanes(value.count, f"{own}[{LANE}] = {value.text};")
        return view

    def lanes_of(self, made: TranslatedFunction, texts: list[str], count: int) -> LaneValues:
        own = self.fresh("lanes")
        self.made.variables[own] = ArrayView(REAL, (count,), own, Origin(own))
        self.line(f"{made.name}(${made.name}${', ' if texts else ''}{', '.join([*texts, own])});")
        return LaneValues(count, f"{own}[{LANE}]")
