"""Vector registers in compiled code: several numbers that one instruction works on.

The compiler makes vectors of plain loops only where it can prove that nothing overlaps, which it mostly can't. Here
vectors are explicit; a register that is wider than the machine's becomes several of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model
from numpy.polynomial.chebyshev import cheb2poly

from hybrid_sysid_ros.support.arrays import LINE

FUSED = ("contract",)
"""Flag that lets a product and a sum become one operation, which rounds once instead of twice."""

ROUNDER = 1.5 * 2.0**52
"""Adding and subtracting it rounds to a whole number, which is also in the low bits of the sum."""


class Register(types.Type):  # type: ignore[misc]
    """The compiler's type of several numbers side by side."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"{type(self).__name__}({lanes})")


@register_model(Register)
class RegisterModel(models.PrimitiveModel):  # type: ignore[misc]
    """A register as LLVM's vector."""

    def __init__(self, manager: Any, register: Register) -> None:
        super().__init__(manager, register, vector(register.lanes))


def vector(lanes: int) -> ir.VectorType:
    """LLVM's type of a register."""
    return ir.VectorType(ir.DoubleType(), lanes)


def constant(value: float, lanes: int) -> ir.Constant:
    """A register with the same constant in every lane."""
    return ir.Constant(vector(lanes), [value] * lanes)


def splat(builder: Any, value: Any, lanes: int) -> Any:
    """A register with the same number in every lane."""
    one = builder.insert_element(ir.Constant(vector(lanes), ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    lane = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(vector(lanes), ir.Undefined), lane)


def fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c."""
    return builder.fadd(builder.fmul(a, b, flags=FUSED), c, flags=FUSED)


def address_of(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The address of the first number of an array or a scratch."""
    return value if isinstance(kind, types.CPointer) else context.make_array(kind)(context, builder, value).data


def _place(context: Any, builder: Any, kind: Any, memory: Any, at: Any, lanes: int) -> Any:
    begin = address_of(context, builder, kind, memory)
    return builder.bitcast(builder.gep(begin, [at]), vector(lanes).as_pointer())


@intrinsic
def scratch(typingctx, numbers):  # type: ignore[no-untyped-def]
    """Memory on the stack for a literal number of numbers, which is freed when the function returns."""
    if not isinstance(numbers, types.IntegerLiteral):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = ir.Constant(ir.IntType(64), numbers.literal_value)
        memory = cgutils.alloca_once(builder, ir.DoubleType(), size=size)
        if numbers.literal_value >= LINE // 8:
            memory.align = LINE
        return memory

    return types.CPointer(types.float64)(numbers), build


@intrinsic
def select(typingctx, test, number, other):  # type: ignore[no-untyped-def]
    """One of two numbers, both of which are known: a branch for each takes numba far longer to compile."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return types.float64(types.boolean, types.float64, types.float64), build


@intrinsic
def behind(typingctx, memory, at):  # type: ignore[no-untyped-def]
    """The memory of an array or a scratch from ``at`` on."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        begin = address_of(context, builder, signature.args[0], arguments[0])
        return builder.gep(begin, [arguments[1]])

    return types.CPointer(types.float64)(memory, types.intp), build


@intrinsic
def load_numbers(typingctx, memory, at, lanes):  # type: ignore[no-untyped-def]
    """The numbers of an array or a scratch from ``at`` on; lanes: a literal."""
    if not isinstance(lanes, types.IntegerLiteral):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature.args[0], arguments[0], arguments[1], lanes.literal_value)
        return builder.load(place, align=8)

    return Register(lanes.literal_value)(memory, types.intp, lanes), build


@intrinsic
def store(typingctx, memory, at, register):  # type: ignore[no-untyped-def]
    """Write a register to an array or a scratch from ``at`` on."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature.args[0], arguments[0], arguments[1], register.lanes)
        builder.store(arguments[2], place, align=8)
        return context.get_dummy_value()

    return types.void(memory, types.intp, register), build


def _elementwise(build: Callable[..., Any]) -> Any:
    """An intrinsic from registers to a register; ``build`` gets the builder and the registers."""

    @intrinsic
    def one(typingctx, a):  # type: ignore[no-untyped-def]
        return a(a), lambda context, builder, signature, arguments: build(builder, *arguments)

    @intrinsic
    def two(typingctx, a, b):  # type: ignore[no-untyped-def]
        return a(a, b), lambda context, builder, signature, arguments: build(builder, *arguments)

    return one if build.__code__.co_argcount == 2 else two


added = _elementwise(lambda builder, a, b: builder.fadd(a, b, flags=FUSED))
"""a + b, lane by lane."""
multiplied = _elementwise(lambda builder, a, b: builder.fmul(a, b, flags=FUSED))
"""a b, lane by lane."""
tanh_derivative = _elementwise(
    lambda builder, h: builder.fsub(constant(1.0, h.type.count), builder.fmul(h, h, flags=FUSED), flags=FUSED)
)
"""1 - h^2: the derivative of h = tanh z."""


@intrinsic
def zero(typingctx, lanes):  # type: ignore[no-untyped-def]
    """A register of zeros; lanes: a literal."""
    if not isinstance(lanes, types.IntegerLiteral):
        return None
    count = lanes.literal_value
    return Register(count)(lanes), lambda context, builder, signature, arguments: constant(0.0, count)


@intrinsic
def plus_scaled(typingctx, total, register, factor):  # type: ignore[no-untyped-def]
    """Return total + register * factor, where factor is a number."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total, register, factor = arguments
        return fused(builder, register, splat(builder, factor, total.type.count), total)

    return total(total, register, types.float64), build


@intrinsic
def summed(typingctx, register):  # type: ignore[no-untyped-def]
    """The sum of the lanes."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType(), arguments[0].type])
        name = f"llvm.vector.reduce.fadd.v{register.lanes}f64"
        reduce = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(reduce, [ir.Constant(ir.DoubleType(), 0.0), arguments[0]], fastmath=("reassoc",))

    return types.float64(register), build


def _economised() -> list[float]:
    """Coefficients of exp(2 r) where |r| <= log(2) / 4, to 2e-16: Taylor's of order 12, less Chebyshev polynomials of
    the highest two orders (Lanczos 1938).
    """
    found = [2.0**order / math.factorial(order) for order in range(13)]
    for order in (12, 11):
        small = cheb2poly([0.0] * order + [1.0]) / (0.25 * math.log(2.0)) ** np.arange(order + 1)
        found = [value - found[order] / small[order] * part for value, part in zip(found, small, strict=False)][:-1]
    return [float(value) for value in found]


POWER = _economised()


@_elementwise
def tanh(builder: Any, x: Any) -> Any:
    """1 - 2 / (exp(2 x) + 1) to 4e-16, half a nanosecond a lane; exp(2 x) = 2^n exp(2 r)."""
    lanes = x.type.count
    limit = constant(20.0, lanes)
    x = builder.select(builder.fcmp_ordered(">", x, limit), limit, x)
    x = builder.select(builder.fcmp_ordered("<", x, constant(-20.0, lanes)), constant(-20.0, lanes), x)
    shifted = fused(builder, x, constant(2.0 / math.log(2.0), lanes), constant(ROUNDER, lanes))
    n = builder.fsub(shifted, constant(ROUNDER, lanes))
    r = fused(builder, n, constant(-0.5 * math.log(2.0), lanes), x)
    power = constant(POWER[-1], lanes)
    for coefficient in POWER[-2::-1]:
        power = fused(builder, power, r, constant(coefficient, lanes))
    bits = ir.VectorType(ir.IntType(64), lanes)
    exponent = builder.shl(builder.bitcast(shifted, bits), ir.Constant(bits, [52] * lanes))
    scale = builder.bitcast(builder.add(exponent, ir.Constant(bits, [1023 << 52] * lanes)), x.type)
    one = constant(1.0, lanes)
    return builder.fsub(one, builder.fdiv(constant(2.0, lanes), fused(builder, power, scale, one)))
