"""Printing: a trace as the source of compiled functions, a line an operation.

Every printed function has the signature of :data:`VALUE` or :data:`SLOPES`, whatever the system, so that loops over
steps (rollouts, filters, shooting) are compiled once for all and take functions by their addresses.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi

from hybrid_sysid_ros.core import trace
from hybrid_sysid_ros.core.blocks import Block, Call
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.trace import Trace

PRELUDE = '''"""Printed from {name}; made again where it is missing."""

import math

from hybrid_sysid_ros.core.call import SLOPES, VALUE, compiled, inner
from hybrid_sysid_ros.core.networks import GatedUnits, Perceptron, Polynomial, Softsign
from hybrid_sysid_ros.core.registers import scratch

'''

_OPERATIONS = {
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_NEG: "-{0}",
    casadi.OP_INV: "1.0 / {0}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "{0} + {0}",
    casadi.OP_EXP: "math.exp({0})",
    casadi.OP_LOG: "math.log({0})",
    casadi.OP_LOG1P: "math.log1p({0})",
    casadi.OP_EXPM1: "math.expm1({0})",
    casadi.OP_POW: "{0} ** {1}",
    casadi.OP_CONSTPOW: "{0} ** {1}",
    casadi.OP_SQRT: "math.sqrt({0})",
    casadi.OP_SIN: "math.sin({0})",
    casadi.OP_COS: "math.cos({0})",
    casadi.OP_TAN: "math.tan({0})",
    casadi.OP_ASIN: "math.asin({0})",
    casadi.OP_ACOS: "math.acos({0})",
    casadi.OP_ATAN: "math.atan({0})",
    casadi.OP_ATAN2: "math.atan2({0}, {1})",
    casadi.OP_SINH: "math.sinh({0})",
    casadi.OP_COSH: "math.cosh({0})",
    casadi.OP_TANH: "math.tanh({0})",
    casadi.OP_ASINH: "math.asinh({0})",
    casadi.OP_ACOSH: "math.acosh({0})",
    casadi.OP_ATANH: "math.atanh({0})",
    casadi.OP_ERF: "math.erf({0})",
    casadi.OP_HYPOT: "math.hypot({0}, {1})",
    casadi.OP_FLOOR: "math.floor({0})",
    casadi.OP_CEIL: "math.ceil({0})",
    casadi.OP_FMOD: "math.fmod({0}, {1})",
    casadi.OP_FABS: "abs({0})",
    casadi.OP_COPYSIGN: "math.copysign({0}, {1})",
    casadi.OP_SIGN: "(1.0 if {0} > 0.0 else (-1.0 if {0} < 0.0 else 0.0))",
    casadi.OP_FMIN: "({0} if {0} < {1} else {1})",
    casadi.OP_FMAX: "({0} if {0} > {1} else {1})",
    casadi.OP_LT: "(1.0 if {0} < {1} else 0.0)",
    casadi.OP_LE: "(1.0 if {0} <= {1} else 0.0)",
    casadi.OP_EQ: "(1.0 if {0} == {1} else 0.0)",
    casadi.OP_NE: "(1.0 if {0} != {1} else 0.0)",
    casadi.OP_NOT: "(1.0 if {0} == 0.0 else 0.0)",
    casadi.OP_AND: "(1.0 if {0} != 0.0 and {1} != 0.0 else 0.0)",
    casadi.OP_OR: "(1.0 if {0} != 0.0 or {1} != 0.0 else 0.0)",
    casadi.OP_IF_ELSE_ZERO: "({1} if {0} != 0.0 else 0.0)",
}


@dataclass(frozen=True, kw_only=True)
class Columns:
    """By what slopes are: states, inputs, some parameters (by index) and, where asked for, the weights, in order."""

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


def columns_of(system: System, *, learn: bool) -> Columns:
    """Slopes by states and inputs; where a fit learns also by all parameters that are not fixed, and the weights."""
    free = tuple(i for i, item in enumerate(system.parameters) if not item.fixed) if learn else ()
    weights = len(system.weights) if learn else 0
    return Columns(states=len(system.states), inputs=len(system.inputs), parameters=free, weights=weights)


def value_source(system: System, *, output: bool = False) -> str:
    """Source of the module whose ``function`` is the step, or the output map. Raises UserError for a wrong law."""
    return _module(system, output=output, smooth=False, columns=None)


def slopes_source(system: System, columns: Columns, *, output: bool = False, smooth: bool = False) -> str:
    """Source of the module whose ``function`` is the same with its slopes."""
    return _module(system, output=output, smooth=smooth, columns=columns)


def _module(system: System, *, output: bool, smooth: bool, columns: Columns | None) -> str:
    staged = bool(system.stepper.stages) and not output
    traced = (
        trace.output_of(system) if output else trace.law_of(system) if staged else trace.step_of(system, smooth=smooth)
    )
    name = "law" if staged else "function"
    signature = "VALUE" if columns is None else "SLOPES"
    lines = [f"@compiled({signature})" if not staged else "@inner"]
    lines += [f"def {name}(x, u, p, w, h, s, out{'' if columns is None else ', slopes'}):"]
    lines += [f"    {line}" for line in _body(traced, columns)]
    blocks = _blocks(traced.calls)
    head = [f"value_{i}, slopes_{i}, weight_slopes_{i} = {block.code}.kernels" for i, block in enumerate(blocks)]
    parts = [PRELUDE.format(name=type(system).__name__) + "\n".join(head), "\n".join(lines)]
    if staged:
        parts.append(_staged(system, columns))
    text = "\n\n\n".join(parts).rstrip() + "\n"
    return f"# {_library()}\n{text}"


def _blocks(calls: Sequence[Call]) -> list[Block]:
    found: list[Block] = []
    for call in calls:
        if not any(call.block is block for block in found):
            found.append(call.block)
    return found


def _body(traced: Trace, columns: Columns | None) -> Iterator[str]:
    calls, blocks = traced.calls, _blocks(traced.calls)
    known: list[tuple[str, casadi.SX]] = [
        ("x", traced.x),
        ("u", traced.u),
        ("p", traced.p),
        ("h", traced.h),
        ("s", traced.s),
    ]
    for number, call in enumerate(calls):
        block = call.block
        yield f"z{number}, y{number} = scratch({block.features}), scratch({block.outputs})"
        yield from _assigned(known, {f"z{number}": call.features})
        which = blocks.index(block)
        if columns is None:
            yield f"value_{which}(w, {block.at}, z{number}, y{number})"
        else:
            yield f"g{number} = scratch({block.outputs * block.features})"
            yield f"slopes_{which}(w, {block.at}, z{number}, y{number}, g{number})"
            known.append((f"g{number}", casadi.vec(call.slopes.T)))  # along rows
        known.append((f"y{number}", call.outputs))
    if columns is None:
        yield from _assigned(known, {"out": traced.result})
        return
    width = columns.count
    seeds = [traced.x, traced.u]
    if columns.parameters:
        seeds.append(traced.p[list(columns.parameters)])
    seed = casadi.vertcat(*seeds)
    through: list[casadi.SX] = []  # derivative of each call's outputs by the seed
    for number, call in enumerate(calls):
        total = casadi.jacobian(call.features, seed)
        for before, slope in zip(calls[:number], through, strict=False):
            total += casadi.mtimes(casadi.jacobian(call.features, before.outputs), slope)
        through.append(casadi.mtimes(call.slopes, total))
    jacobian = casadi.jacobian(traced.result, seed)
    by_call = [casadi.jacobian(traced.result, call.outputs) for call in calls]
    for direct, slope in zip(by_call, through, strict=True):
        jacobian += casadi.mtimes(direct, slope)
    yield f"for i in range({traced.result.numel() * width}):"
    yield "    slopes[i] = 0.0"
    yield from _assigned(known, {"out": traced.result, f"slopes:{width}": casadi.sparsify(jacobian)})
    if columns.weights:
        yield from _by_weights(traced, columns, known, by_call)


def _by_weights(
    traced: Trace, columns: Columns, known: list[tuple[str, casadi.SX]], by_call: Sequence[casadi.SX]
) -> Iterator[str]:
    """Slopes by the weights: those of each call, by how the result depends on its outputs."""
    calls, blocks = traced.calls, _blocks(traced.calls)
    total = list(by_call)
    for later in range(len(calls) - 1, -1, -1):  # what a call gives, later calls may read
        for number in range(later):
            through = casadi.mtimes(calls[later].slopes, casadi.jacobian(calls[later].features, calls[number].outputs))
            total[number] = total[number] + casadi.mtimes(total[later], through)
    for number, call in enumerate(calls):
        factors = casadi.sparsify(total[number])
        yield f"f{number} = scratch({call.block.outputs})"
        for row in range(traced.result.numel()):
            if factors[row, :].nnz():
                yield from _assigned(known, {f"f{number}": casadi.densify(factors[row, :].T)})
                start = row * columns.count + columns.first_weight + call.block.at
                yield (
                    f"weight_slopes_{blocks.index(call.block)}(w, {call.block.at}, z{number}, f{number}, slopes, "
                    f"{start})"
                )


def _assigned(known: Sequence[tuple[str, casadi.SX]], targets: dict[str, casadi.SX]) -> Iterator[str]:
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
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        to, of = function.instruction_output(k), function.instruction_input(k)
        if operation == casadi.OP_INPUT:
            name = known[of[0]][0]
            yield f"a{to[0]} = {name if name in scalars else f'{name}[{of[1]}]'}"
        elif operation == casadi.OP_OUTPUT:
            yield f"{places[to[0]][to[1]]} = a{of[0]}"
        elif operation == casadi.OP_CONST:
            yield f"a{to[0]} = {_number(function.instruction_constant(k))}"
        else:
            yield f"a{to[0]} = {_OPERATIONS[operation].format(*(f'a{index}' for index in of))}"


def _number(value: float) -> str:
    if value != value or value in (float("inf"), float("-inf")):
        return {"nan": "math.nan", "inf": "math.inf", "-inf": "-math.inf"}[str(value)]
    return repr(float(value))


def _staged(system: System, columns: Columns | None) -> str:
    """Runge-Kutta around the printed law, with the derivative of each stage carried along."""
    n = len(system.states)
    if columns is None:
        return f"""@compiled(VALUE)
def function(x, u, p, w, h, s, out):
    k, z, total = scratch({n}), scratch({n}), scratch({n})
    for i in range({n}):
        z[i] = x[i]
        total[i] = 0.0
    for stage in range(4):
        law(z, u, p, w, h, s, k)
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range({n}):
            total[i] += weight * k[i]
            z[i] = x[i] + ahead * k[i]
    for i in range({n}):
        out[i] = x[i] + h / 6.0 * total[i]
"""
    c = columns.count
    return f"""@compiled(SLOPES)
def function(x, u, p, w, h, s, out, slopes):
    k, z, total = scratch({n}), scratch({n}), scratch({n})
    by_k, by_z = scratch({n * c}), scratch({n * c})
    for i in range({n}):
        z[i] = x[i]
        total[i] = 0.0
    for i in range({n * c}):
        by_z[i] = 0.0
        slopes[i] = 0.0
    for i in range({n}):
        by_z[i * {c} + i] = 1.0
    for stage in range(4):
        law(z, u, p, w, h, s, k, by_k)
        for i in range({n}):
            own = scratch({n})
            for l in range({n}):
                own[l] = by_k[i * {c} + l]
                by_k[i * {c} + l] = 0.0
            for l in range({n}):
                slope = own[l]
                for j in range({c}):
                    by_k[i * {c} + j] += slope * by_z[l * {c} + j]
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range({n}):
            total[i] += weight * k[i]
            z[i] = x[i] + ahead * k[i]
        for i in range({n * c}):
            slopes[i] += weight * by_k[i]
            by_z[i] = ahead * by_k[i]
        for i in range({n}):
            by_z[i * {c} + i] += 1.0
    for i in range({n}):
        out[i] = x[i] + h / 6.0 * total[i]
    for i in range({n * c}):
        slopes[i] *= h / 6.0
    for i in range({n}):
        slopes[i * {c} + i] += 1.0
"""


@cache
def _library() -> str:
    """Digest of what printed code is linked with: other code needs other modules."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
