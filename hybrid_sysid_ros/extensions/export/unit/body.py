"""Statements of a kernel in C."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export.unit.assignments import Assignments
from hybrid_sysid_ros.extensions.export.unit.names import safe
from hybrid_sysid_ros.extensions.export.unit.translation import is_known, parameter
from hybrid_sysid_ros.extensions.export.unit.values import (
    INT,
    LANE,
    REAL,
    SUM,
    ArrayView,
    KnownValue,
    LaneValues,
    NumberValue,
    StructureValue,
    TupleValue,
    Value,
    bracketed,
    cannot,
)


class FunctionBody(Assignments):
    """Translates the statements of one variant of a function."""

    def translate(self, arguments: list[Value]) -> None:
        """Translate the function for arguments into ``made``."""
        bound = []
        for index, (item, value) in enumerate(zip(self.tree.args.args, arguments, strict=True)):
            name = item.arg
            if is_known(value) or (isinstance(value, KnownValue) and isinstance(value.value, np.ndarray)):
                self.values[name] = value
                if self.counts[name]:
                    self.set_variable(name, value)
                continue
            own = parameter(safe(name), value)
            self.values[name] = own
            bound.append((index, safe(name), own))
        self._block(self.tree.body)
        self.made.unused = {*self.made.variables} - self.read
        for name in self.made_here.keys() - self.read:
            line = self.made.lines[self.made_here[name]]
            self.made.lines[self.made_here[name]] = "" if "$" not in line else f"{line} (void){name};"
        text = "\n".join(self.made.lines)
        for index, name, own in bound:
            if re.search(rf"\b{name}\b", text):
                self.made.order.append(index)
                self.made.parameters.append((name, own))
        self.made.arrays = set(re.findall(r"@(\w+)@", text))

    # ------------------------------------------------------------------ statements

    def _block(self, nodes: list[ast.stmt]) -> None:
        for node in nodes:
            if not self.ended:
                self._statement(node)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                found = self.value(value)
                for target in targets:
                    self.assign(target, found)
            case ast.AugAssign(target=target, op=op, value=value):
                self._change(target, op, value)
            case ast.For(target=target, iter=iterated, body=body):
                self._loop(target, iterated, body)
            case ast.While(test=test, body=body):
                truth = self.condition(self.value(test))
                self._within("for (;;)" if isinstance(truth, KnownValue) else f"while ({truth.text})", body)
                self.ended = isinstance(truth, KnownValue) and not any(
                    isinstance(item, ast.Break) for item in ast.walk(node)
                )
            case ast.If(test=test, body=body, orelse=other):
                self._branch(test, body, other)
            case ast.Return(value=value):
                self._return(None if value is None else self.value(value))
            case ast.Break() | ast.Continue():
                self.line("break;" if isinstance(node, ast.Break) else "continue;")
                self.ended = True
            case ast.Expr(value=ast.Call() as call):
                result = self.call(call)
                if isinstance(result, NumberValue | ArrayView):
                    self.line(f"{result.text};")
            case ast.Expr(value=ast.Constant()) | ast.Pass() | ast.Import() | ast.ImportFrom():
                pass
            case _:
                raise cannot(ast.unparse(node).partition("\n")[0], self.where)

    def _branch(self, test: ast.expr, body: list[ast.stmt], other: list[ast.stmt]) -> None:
        truth = self.condition(self.value(test))
        if isinstance(truth, KnownValue):
            self._block(body if truth.value else other)
            return
        first = self._within(f"if ({truth.text})", body)
        second = self._within("else", other) if other else False
        self.ended = first and second

    def _within(self, head: str, body: list[ast.stmt]) -> bool:
        """Write a block; whether it never goes on behind its end."""
        if head == "else" and self.made.lines[-1].strip() == "}":
            self.made.lines[-1] += " else {"
        else:
            self.line(f"{head} {{")
        self.depth += 1
        self._block(body)
        ended, self.ended = self.ended, False
        self.depth -= 1
        self.line("}")
        return ended

    def _loop(self, target: ast.expr, iterated: ast.expr, body: list[ast.stmt]) -> None:
        if not (isinstance(iterated, ast.Call) and isinstance(iterated.func, ast.Name) and iterated.func.id == "range"):
            raise cannot(f"a loop over {ast.unparse(iterated)}", self.where)
        assert isinstance(target, ast.Name)
        given = [self.value(item) for item in iterated.args]
        start, stop, step = (KnownValue(0), *given, KnownValue(1)) if len(given) == 1 else (*given, KnownValue(1))[:3]
        assert isinstance(step, KnownValue)
        if (
            isinstance(start, KnownValue)
            and isinstance(stop, KnownValue)
            and not len(range(start.value, stop.value, step.value))
        ):
            return
        end = self.number(stop)
        if "->" in end.text or "@" in end.text or "$" in end.text:
            end = self.temporary("end", end)  # Python takes it once
        name, before = safe(target.id if target.id != "_" else self.fresh("turn")), self.values.get(target.id)
        if self.counts[target.id] > 1:
            self.set_variable(target.id, start)
            head = "for (; "
        else:
            self.values[target.id] = NumberValue(INT, name)
            head = f"for (int {name} = {self.number(start).text}; "
        by = step.value
        change = f"{name}++" if by == 1 else f"{name}--" if by == -1 else f"{name} += {by}"
        self._within(f"{head}{name} {'<' if by > 0 else '>'} {bracketed(end, SUM)}; {change})", body)
        if self.counts[target.id] < 2:
            self.values.pop(target.id, None)
            self.values |= {} if before is None else {target.id: before}

    def _return(self, value: Value | None) -> None:
        self.ended = True
        match value:
            case None:
                self.line("return;")
                return
            case TupleValue(values=values, names=names, of=kind):
                numbers = [self.number(item) for item in values]
                kinds = tuple(item.kind for item in numbers)  # type: ignore[union-attr]
                names = names or tuple(f"part{k}" for k in range(len(values)))
                type_ = self.translator.structure(kind or f"{self.function.__name__}_result", names, kinds)
                name = self.fresh("result")
                self.line(f"{type_} {name};")
                for part, number in zip(names, numbers, strict=True):
                    self.line(f"{name}.{part} = {number.text};")
                self.line(f"return {name};")
                self._result(StructureValue(type_, names, kinds, ""))
            case StructureValue():
                self.line(f"return {value.text};")
                self._result(value)
            case ArrayView():
                self.made.place.take(value.place)
                self.line(f"return {value.text};")
                self._result(value)
            case LaneValues(count=count):
                self.on_lanes(count, f"result[{LANE}] = {value.text};")
                self._result(value)
            case _:
                before = self.made.result
                real = isinstance(before, NumberValue) and before.kind == REAL
                number = self.number(value, REAL if real else None)
                assert isinstance(number, NumberValue)
                self.line(f"return {number.text};")
                self._result(number)

    def _result(self, value: Any) -> None:
        before = self.made.result
        if isinstance(before, ArrayView) and before.shape != value.shape:
            value = replace(value, shape=(None,))
        if isinstance(before, NumberValue) and before.kind != value.kind and REAL in (before.kind, value.kind):
            raise cannot("a result that is sometimes whole and sometimes not", self.where)
        self.made.result = value
