"""Printing: a trace becomes the source of compiled functions, one line for each operation.

Every printed function has the signature :data:`VALUE` or :data:`JACOBIAN`, whatever the system. So loops over steps
(rollouts, filters, shooting) are compiled once for all systems, and take functions by their addresses.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi

from hybrid_sysid_ros.core import call as call_module
from hybrid_sysid_ros.core import chain_rule, trace
from hybrid_sysid_ros.core.blocks import BlockCall
from hybrid_sysid_ros.core.compilation import digest
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.trace import Trace
from hybrid_sysid_ros.support.errors import UserError

PRELUDE = '''"""Printed from {name}, linked with sources of digest {digest}; made again where it is missing."""

import math

from hybrid_sysid_ros.core.call import JACOBIAN, VALUE, compiled, inner
from hybrid_sysid_ros.core.registers import load_numbers, plus_scaled, scratch, select, store, zero
'''

_FUNCTIONS = (
    "exp", "log", "log1p", "expm1", "sqrt", "erf", "floor", "ceil", "sin", "cos", "tan", "asin", "acos", "atan", "sinh",
    "cosh", "tanh", "asinh", "acosh", "atanh",
)  # fmt: skip
_COMPARISONS = {
    casadi.OP_LT: "{0} < {1}",
    casadi.OP_LE: "{0} <= {1}",
    casadi.OP_EQ: "{0} == {1}",
    casadi.OP_NE: "{0} != {1}",
}
_OPERATIONS = {
    **{getattr(casadi, f"OP_{name.upper()}"): f"math.{name}({{0}})" for name in _FUNCTIONS},
    **{
        getattr(casadi, f"OP_{name.upper()}"): f"math.{name}({{0}}, {{1}})"
        for name in ("atan2", "hypot", "fmod", "copysign")
    },
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_NEG: "-{0}",
    casadi.OP_INV: "1.0 / {0}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "{0} + {0}",
    casadi.OP_POW: "{0} ** {1}",
    casadi.OP_CONSTPOW: "{0} ** {1}",
    casadi.OP_FABS: "abs({0})",
    casadi.OP_SIGN: "select({0} > 0.0, 1.0, select({0} < 0.0, -1.0, 0.0))",
    casadi.OP_FMIN: "select({0} < {1}, {0}, {1})",
    casadi.OP_FMAX: "select({0} > {1}, {0}, {1})",
    **{operation: f"select({text}, 1.0, 0.0)" for operation, text in _COMPARISONS.items()},
    casadi.OP_NOT: "select({0} == 0.0, 1.0, 0.0)",
    casadi.OP_AND: "select({0} != 0.0, select({1} != 0.0, 1.0, 0.0), 0.0)",
    casadi.OP_OR: "select({0} != 0.0, 1.0, select({1} != 0.0, 1.0, 0.0))",
    casadi.OP_IF_ELSE_ZERO: "select({0} != 0.0, {1}, 0.0)",
}


@dataclass(frozen=True, kw_only=True)
class JacobianColumns:
    """Columns of a Jacobian: states, inputs, some parameters (by index) and, where asked for, the weights, in order."""

    states: int
    inputs: int
    parameters: tuple[int, ...] = ()
    weights: int = 0

    @property
    def count(self) -> int:
        return self.states + self.inputs + len(self.parameters) + self.weights

    @property
    def first_weight(self) -> int:
        return self.count - self.weights


def jacobian_columns(system: System, *, learn: bool) -> JacobianColumns:
    """Columns by states and inputs; with ``learn`` also by all parameters that are not fixed, and by the weights."""
    free = tuple(i for i, item in enumerate(system.parameters) if not item.fixed) if learn else ()
    weights = len(system.weights) if learn else 0
    return JacobianColumns(states=len(system.states), inputs=len(system.inputs), parameters=free, weights=weights)


def source_of(
    system: System,
    columns: JacobianColumns | None = None,
    *,
    output: bool = False,
    smooth: bool = False,
    through: bool = False,
) -> str:
    """Source of the module whose ``function`` is the step or the output map, with its Jacobian by ``columns`` if given.
    through: a step goes on from derivatives of [x; u] that it is given, by the chain rule.

    Raises UserError for a law that can't be traced or compiled.
    """
    staged = system.stepper.staged and not output
    if output:
        traced = trace.output_of(system)
    else:
        trace_of = trace.law_of if staged else trace.step_of
        traced = trace_of(system, smooth=smooth)
    jacobian = None if columns is None else casadi.sparsify(_jacobian(traced, columns))
    signature, more = ("VALUE", "") if columns is None else ("JACOBIAN", ", jacobian")
    inside = "law" if staged else "step" if through else ""
    lines = ["@inner" if inside else f"@compiled({signature})"]
    lines += [f"def {inside or 'function'}(x, u, p, w, h, s, out{more}):"]
    lines += [f"    {line}" for line in _body(traced, columns, jacobian)]
    parts = [_head(system, traced.calls), "\n".join(lines)]
    slopes = None if columns is None or jacobian is None else _slopes(columns, jacobian)
    if staged:
        parts.append(system.stepper.around(len(system.states), slopes))
    elif slopes and through:
        parts.append(slopes.around_step())
    if slopes and inside:
        parts.append(slopes.around(through))
    return "\n\n\n".join(part.rstrip() for part in parts) + "\n"


def _slopes(columns: JacobianColumns, jacobian: casadi.SX) -> chain_rule.Slopes:
    """The Jacobian of a law or a step. Columns by parameters and weights are many, and stand alone."""
    return chain_rule.Slopes(
        rows=columns.states,
        columns=columns.count,
        seeds=columns.states if columns.parameters or columns.weights else columns.count,
        filled=set(zip(*jacobian.sparsity().get_triplet(), strict=True)),
    )


def _head(system: System, calls: Sequence[BlockCall]) -> str:
    """Imports, and the compiled functions of each kind of block. The digest of the imports is part of the source."""
    makers = {call.block.code: type(call.block) for call in calls}
    modules = {kind.__module__ for kind in makers.values()}
    lines = [PRELUDE.format(name=type(system).__name__, digest=digest(call_module.__name__, *modules)).rstrip()]
    lines += sorted({f"from {kind.__module__} import {kind.__name__}" for kind in makers.values()})
    lines += [""] if makers else []
    lines += [f"value_{i}, jacobian_{i}, weight_gradient_{i} = {code}.functions" for i, code in enumerate(makers)]
    return "\n".join(lines)


def _kinds(calls: Sequence[BlockCall]) -> list[str]:
    """The kinds of blocks: those that differ only in the index of their weights share compiled functions."""
    return list(dict.fromkeys(call.block.code for call in calls))


@dataclass(frozen=True)
class _Part:
    """A part of a printed function: dense vectors "name" or the non-zeros of matrices "name:width", and the lines
    behind their assignments.
    """

    target: str
    expression: casadi.SX
    after: tuple[str, ...] = ()

    def places(self) -> list[str]:
        """What the non-zeros are assigned to."""
        rows, columns = self.expression.sparsity().get_triplet()
        name, _, width = self.target.partition(":")
        return [f"{name}[{row * int(width or 1) + column}]" for row, column in zip(rows, columns, strict=True)]

    def end(self) -> Iterator[_Line]:
        """Assignments of what is zero in a vector, and the lines behind."""
        if ":" not in self.target:
            for row in sorted({*range(self.expression.numel())} - {*self.expression.sparsity().row()}):
                yield _Line("", f"{self.target}[{row}] = 0.0")
        yield from (_Line("", line) for line in self.after)


def _body(traced: Trace, columns: JacobianColumns | None, jacobian: casadi.SX | None) -> Iterator[str]:
    calls, kinds = traced.calls, _kinds(traced.calls)
    known = [("x", traced.x), ("u", traced.u), ("p", traced.p), ("h", traced.h), ("s", traced.s)]
    parts: list[_Part] = []
    for number, call in enumerate(calls):
        block, z, y, g = call.block, f"z{number}", f"y{number}", f"g{number}"
        which = kinds.index(block.code)
        yield f"{z}, {y} = scratch({block.features}), scratch({block.outputs})"
        known.append((y, call.outputs))
        made = f"value_{which}(w, {block.at}, {z}, {y})"
        if columns is not None:
            yield f"{g} = scratch({block.outputs * block.features})"
            known.append((g, casadi.vec(call.jacobian.T)))  # along rows
            made = f"jacobian_{which}(w, {block.at}, {z}, {y}, {g})"
        parts.append(_Part(z, call.features, (made,)))
    parts.append(_Part("out", traced.result))
    if columns is not None and jacobian is not None:
        width = columns.count
        yield f"for i in range({traced.result.numel() * width}):"
        yield "    jacobian[i] = 0.0"
        parts.append(_Part(f"jacobian:{width}", jacobian))
        if columns.weights:
            yield from (f"f{number} = scratch({call.block.outputs})" for number, call in enumerate(calls))
            parts += _by_weights(traced, columns)
    yield from _assigned(known, parts)


def _jacobian(traced: Trace, columns: JacobianColumns) -> casadi.SX:
    """Derivatives of the result by states, inputs and parameters, by the chain rule over the calls."""
    seed = casadi.vertcat(traced.x, traced.u, traced.p[list(columns.parameters)])
    through: list[casadi.SX] = []  # derivatives of each call's outputs by the seed
    for number, call in enumerate(traced.calls):
        total = casadi.jacobian(call.features, seed)
        for before, slope in zip(traced.calls[:number], through, strict=False):
            total += casadi.mtimes(casadi.jacobian(call.features, before.outputs), slope)
        through.append(casadi.mtimes(call.jacobian, total))
    either = (casadi.jacobian(traced.result, seed, {"helper_options": {"ad_weight": way}}) for way in (0.0, 1.0))
    jacobian = min(either, key=casadi.n_nodes)  # forward or backward, whichever is shorter
    for direct, slope in zip(_by_calls(traced), through, strict=True):
        jacobian += casadi.mtimes(direct, slope)
    return jacobian


def _by_calls(traced: Trace) -> list[casadi.SX]:
    """Derivatives of the result by the outputs of each call."""
    return [casadi.jacobian(traced.result, call.outputs) for call in traced.calls]


def _by_weights(traced: Trace, columns: JacobianColumns) -> Iterator[_Part]:
    """Derivatives by the weights of each call, by the chain rule over the call's outputs."""
    calls, kinds = traced.calls, _kinds(traced.calls)
    total = _by_calls(traced)
    for later in range(len(calls) - 1, -1, -1):  # later calls may read the outputs of a call
        for number in range(later):
            through = casadi.mtimes(
                calls[later].jacobian, casadi.jacobian(calls[later].features, calls[number].outputs)
            )
            total[number] = total[number] + casadi.mtimes(total[later], through)
    for number, call in enumerate(calls):
        factors = casadi.sparsify(total[number])
        for row in range(traced.result.numel()):
            if factors[row, :].nnz():
                start = row * columns.count + columns.first_weight + call.block.at
                made = (
                    f"weight_gradient_{kinds.index(call.block.code)}(w, {call.block.at}, z{number}, f{number}, "
                    f"jacobian, {start})"
                )
                yield _Part(f"f{number}", casadi.densify(factors[row, :].T), (made,))


@dataclass
class _Line:
    """A printed line."""

    name: str
    """Of the value that it computes; empty where it writes a result."""
    text: str
    of: tuple[str, ...] = ()
    """The values that it reads."""


def _assigned(known: Sequence[tuple[str, casadi.SX]], parts: Sequence[_Part]) -> Iterator[str]:
    """Lines that compute the parts one after the other, without computing anything twice. known: names and expressions
    that they may read.
    """
    expressions = casadi.cse([part.expression for part in parts])
    parts = [replace(part, expression=found) for part, found in zip(parts, expressions, strict=True)]
    function = casadi.Function("f", [symbol for _, symbol in known], expressions, {"allow_free": False})
    scalars, places = {"h", "s"}, [part.places() for part in parts]
    names, lines = (f"a{number}" for number in itertools.count()), list[_Line]()
    at, choices = dict[int, str](), _Choices()  # by CasADi's register: each value gets a name of its own
    waiting, done = [len(own) for own in places], 0
    for k in range(function.n_instructions()):
        while waiting[done] == 0:
            lines += parts[done].end()
            done += 1
        operation = function.instruction_id(k)
        to, of = function.instruction_output(k), function.instruction_input(k)
        if operation == casadi.OP_OUTPUT:
            waiting[to[0]] -= 1
            lines.append(_Line("", f"{places[to[0]][to[1]]} = {at[of[0]]}", (at[of[0]],)))
            continue
        name, own = next(names), tuple(at[index] for index in of if operation != casadi.OP_INPUT)
        if operation == casadi.OP_INPUT:
            source = known[of[0]][0]
            value = source if source in scalars else f"{source}[{of[1]}]"
        elif operation == casadi.OP_CONST:
            value = _number(function.instruction_constant(k))
        elif operation in _OPERATIONS:
            value, own = choices.printed(name, operation, own)
        else:
            raise UserError(f"a law uses {_name_of(operation)}, which can't be compiled; write it out otherwise")
        at[to[0]] = name
        lines.append(_Line(name, f"{name} = {value}", own))
    for part in parts[done:]:
        lines += part.end()
    yield from _needed(lines)


class _Choices:
    """Conditions and choices: CasADi has them as numbers, and one of two values as a sum in which one is zero."""

    def __init__(self) -> None:
        self._condition = dict[str, tuple[str, tuple[str, ...]]]()
        self._other = dict[str, str]()
        self._chosen = dict[str, tuple[str, str]]()

    def printed(self, name: str, operation: int, of: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
        """An operation on values, printed, and the values that it reads."""
        if operation in _COMPARISONS:
            self._condition[name] = _COMPARISONS[operation].format(*of), of
        elif operation == casadi.OP_NOT:
            self._other[name] = of[0]
        elif operation == casadi.OP_IF_ELSE_ZERO:
            self._chosen[name] = of[0], of[1]
            return self._select(of[0], of[1], "0.0")
        elif operation == casadi.OP_ADD and of[0] in self._chosen and of[1] in self._chosen:
            (one, value), (other, instead) = self._chosen[of[0]], self._chosen[of[1]]
            if self._other.get(other) == one:
                return self._select(one, value, instead)
            if self._other.get(one) == other:
                return self._select(other, instead, value)
        return _OPERATIONS[operation].format(*of), of

    def _select(self, condition: str, value: str, instead: str) -> tuple[str, tuple[str, ...]]:
        if condition in self._other:
            return self._select(self._other[condition], instead, value)
        text, of = self._condition.get(condition, (f"{condition} != 0.0", (condition,)))
        return f"select({text}, {value}, {instead})", (*of, *{value, instead} - {"0.0"})


def _needed(lines: Sequence[_Line]) -> Iterator[str]:
    """The lines whose values are read, in their order."""
    read, kept = set[str](), list[str]()
    for line in reversed(lines):
        if not line.name or line.name in read:
            read.update(line.of)
            kept.append(line.text)
    yield from reversed(kept)


def _name_of(operation: int) -> str:
    """CasADi's name of an operation."""
    return next(name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == operation)


def _number(value: float) -> str:
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "math.nan", "inf": "math.inf", "-inf": "-math.inf"}[str(value)]
    return repr(float(value))
