"""Printing: a trace becomes the source of compiled functions, one line for each operation.

Every printed function has the signature :data:`VALUE` or :data:`JACOBIAN`, whatever the system. So loops over steps
(rollouts, filters, shooting) are compiled once for all systems, and take functions by their addresses.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi

from hybrid_sysid_ros.core import call as call_module
from hybrid_sysid_ros.core import trace
from hybrid_sysid_ros.core.blocks import BlockCall
from hybrid_sysid_ros.core.compilation import digest
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.trace import Trace
from hybrid_sysid_ros.support.errors import UserError

PRELUDE = '''"""Printed from {name}, linked with sources of digest {digest}; made again where it is missing."""

import math

from hybrid_sysid_ros.core.call import JACOBIAN, VALUE, compiled, inner
from hybrid_sysid_ros.core.registers import scratch, select
'''

_FUNCTIONS = (
    "exp", "log", "log1p", "expm1", "sqrt", "erf", "floor", "ceil", "sin", "cos", "tan", "asin", "acos", "atan", "sinh",
    "cosh", "tanh", "asinh", "acosh", "atanh",
)  # fmt: skip
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
    casadi.OP_LT: "select({0} < {1}, 1.0, 0.0)",
    casadi.OP_LE: "select({0} <= {1}, 1.0, 0.0)",
    casadi.OP_EQ: "select({0} == {1}, 1.0, 0.0)",
    casadi.OP_NE: "select({0} != {1}, 1.0, 0.0)",
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
    system: System, columns: JacobianColumns | None = None, *, output: bool = False, smooth: bool = False
) -> str:
    """Source of the module whose ``function`` is the step or the output map, with its Jacobian by ``columns`` if given.

    Raises UserError for a law that can't be traced or compiled.
    """
    staged = system.stepper.staged and not output
    if output:
        traced = trace.output_of(system)
    else:
        trace_of = trace.law_of if staged else trace.step_of
        traced = trace_of(system, smooth=smooth)
    signature, more = ("VALUE", "") if columns is None else ("JACOBIAN", ", jacobian")
    decorator, name = ("@inner", "law") if staged else (f"@compiled({signature})", "function")
    lines = [decorator, f"def {name}(x, u, p, w, h, s, out{more}):"]
    lines += [f"    {line}" for line in _body(traced, columns)]
    parts = [_head(system, traced.calls), "\n".join(lines)]
    if staged:
        count = None if columns is None else columns.count
        parts.append(system.stepper.around(len(system.states), count))
    return "\n\n\n".join(part.rstrip() for part in parts) + "\n"


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


Known = list[tuple[str, casadi.SX]]
"""Names and expressions that printed lines may read."""


def _body(traced: Trace, columns: JacobianColumns | None) -> Iterator[str]:
    calls, kinds = traced.calls, _kinds(traced.calls)
    names = (f"a{number}" for number in itertools.count())
    known: Known = [
        ("x", traced.x),
        ("u", traced.u),
        ("p", traced.p),
        ("h", traced.h),
        ("s", traced.s),
    ]
    for number, call in enumerate(calls):
        block = call.block
        yield f"z{number}, y{number} = scratch({block.features}), scratch({block.outputs})"
        yield from _assigned(known, {f"z{number}": call.features}, names)
        which = kinds.index(block.code)
        if columns is None:
            yield f"value_{which}(w, {block.at}, z{number}, y{number})"
        else:
            yield f"g{number} = scratch({block.outputs * block.features})"
            yield f"jacobian_{which}(w, {block.at}, z{number}, y{number}, g{number})"
            known.append((f"g{number}", casadi.vec(call.jacobian.T)))  # along rows
        known.append((f"y{number}", call.outputs))
    if columns is None:
        yield from _assigned(known, {"out": traced.result}, names)
        return
    width = columns.count
    seeds = [traced.x, traced.u]
    if columns.parameters:
        seeds.append(traced.p[list(columns.parameters)])
    seed = casadi.vertcat(*seeds)
    through: list[casadi.SX] = []  # derivatives of each call's outputs by the seed
    for number, call in enumerate(calls):
        total = casadi.jacobian(call.features, seed)
        for before, slope in zip(calls[:number], through, strict=False):
            total += casadi.mtimes(casadi.jacobian(call.features, before.outputs), slope)
        through.append(casadi.mtimes(call.jacobian, total))
    jacobian = casadi.jacobian(traced.result, seed)
    by_call = [casadi.jacobian(traced.result, call.outputs) for call in calls]
    for direct, slope in zip(by_call, through, strict=True):
        jacobian += casadi.mtimes(direct, slope)
    yield f"for i in range({traced.result.numel() * width}):"
    yield "    jacobian[i] = 0.0"
    yield from _assigned(known, {"out": traced.result, f"jacobian:{width}": casadi.sparsify(jacobian)}, names)
    if columns.weights:
        yield from _by_weights(traced, columns, known, by_call, names)


def _by_weights(
    traced: Trace, columns: JacobianColumns, known: Known, by_call: Sequence[casadi.SX], names: Iterator[str]
) -> Iterator[str]:
    """Derivatives by the weights of each call, by the chain rule over the call's outputs."""
    calls, kinds = traced.calls, _kinds(traced.calls)
    total = list(by_call)
    for later in range(len(calls) - 1, -1, -1):  # later calls may read the outputs of a call
        for number in range(later):
            through = casadi.mtimes(
                calls[later].jacobian, casadi.jacobian(calls[later].features, calls[number].outputs)
            )
            total[number] = total[number] + casadi.mtimes(total[later], through)
    for number, call in enumerate(calls):
        factors = casadi.sparsify(total[number])
        yield f"f{number} = scratch({call.block.outputs})"
        for row in range(traced.result.numel()):
            if factors[row, :].nnz():
                yield from _assigned(known, {f"f{number}": casadi.densify(factors[row, :].T)}, names)
                start = row * columns.count + columns.first_weight + call.block.at
                yield (
                    f"weight_gradient_{kinds.index(call.block.code)}(w, {call.block.at}, z{number}, f{number}, "
                    f"jacobian, {start})"
                )


def _assigned(known: Known, targets: dict[str, casadi.SX], names: Iterator[str]) -> Iterator[str]:
    """Lines that compute the targets: dense vectors "name", or the non-zeros of matrices "name:width"."""
    outputs = list(targets.items())
    expressions = casadi.cse([expression for _, expression in outputs])
    function = casadi.Function("f", [symbol for _, symbol in known], expressions, {"allow_free": False})
    scalars = {"h", "s"}
    places: list[list[str]] = []
    for (name, _), expression in zip(outputs, expressions, strict=True):
        if ":" in name:
            target, width = name.split(":")
            rows, cols = expression.sparsity().get_triplet()
            places.append([f"{target}[{row * int(width) + col}]" for row, col in zip(rows, cols, strict=True)])
        else:
            rows, _ = expression.sparsity().get_triplet()
            places.append([f"{name}[{row}]" for row in rows])
            for row in sorted(set(range(expression.numel())) - set(rows)):
                yield f"{name}[{row}] = 0.0"
    at: dict[int, str] = {}  # by CasADi's register; each value gets a name of its own, which compiles faster
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        to, of = function.instruction_output(k), function.instruction_input(k)
        if operation == casadi.OP_OUTPUT:
            yield f"{places[to[0]][to[1]]} = {at[of[0]]}"
            continue
        if operation == casadi.OP_INPUT:
            name = known[of[0]][0]
            value = name if name in scalars else f"{name}[{of[1]}]"
        elif operation == casadi.OP_CONST:
            value = _number(function.instruction_constant(k))
        elif operation in _OPERATIONS:
            value = _OPERATIONS[operation].format(*(at[index] for index in of))
        else:
            raise UserError(f"a law uses {_name_of(operation)}, which can't be compiled; write it out otherwise")
        at[to[0]] = next(names)
        yield f"{at[to[0]]} = {value}"


def _name_of(operation: int) -> str:
    """CasADi's name of an operation."""
    return next(name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == operation)


def _number(value: float) -> str:
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "math.nan", "inf": "math.inf", "-inf": "-math.inf"}[str(value)]
    return repr(float(value))
