"""Dual numbers for compiled laws: a value and its derivatives, carried through every operation at once.

A dual number is one vector register, lane 0 the value and the other lanes its derivatives, so that a product costs two
multiplications whatever the number of derivatives that fit into it. Source: Griewank & Walther (2008), Evaluating
Derivatives, section 3.1 (vector forward mode).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typeconv import Conversion
from numba.extending import intrinsic, lower_cast, models, overload, register_model

from hybrid_sysid_ros.core import registers
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.core.operations import Operations
from hybrid_sysid_ros.core.perceptron import Perceptron, passes
from hybrid_sysid_ros.core.registers import FUSED, Register, RegisterModel, constant, splat, vector

_overload = partial(overload, jit_options=OPTIONS, strict=False)
"""Without the check that a lambda has the type hints of its overload."""


class Dual(Register):
    """The compiler's type of a dual number of so many lanes; a plain number converts to one without derivatives."""

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, typingctx: Any, other: Any) -> Any:
        return self if isinstance(other, types.Number) else None


class DualRows(types.Type):  # type: ignore[misc]
    """The compiler's type of a vector of dual numbers: the rows of a C-contiguous array (numbers, lanes)."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"DualRows({lanes})")


register_model(Dual)(RegisterModel)


@register_model(DualRows)
class _DualRowsModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, rows: DualRows) -> None:
        members = [("data", types.CPointer(types.float64)), ("count", types.intp)]
        super().__init__(manager, rows, members)


def _first(builder: Any, vector: Any) -> Any:
    return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))


def _with_first(builder: Any, vector: Any, value: Any) -> Any:
    return builder.insert_element(vector, value, ir.Constant(ir.IntType(32), 0))


@lower_cast(types.Number, Dual)
def _converted(context: Any, builder: Any, number: Any, dual: Any, value: Any) -> Any:
    value = context.cast(builder, value, number, types.float64)
    return _with_first(builder, constant(0.0, dual.lanes), value)


@intrinsic
def value_of(typingctx, number):  # type: ignore[no-untyped-def]
    """The value of a dual number, without its derivatives."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _first(builder, arguments[0])

    return types.float64(number), build


@intrinsic
def scaled(typingctx, number, factor):  # type: ignore[no-untyped-def]
    """Every lane times a number."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fmul(arguments[0], splat(builder, arguments[1], number.lanes), flags=FUSED)

    return number(number, types.float64), build


@intrinsic
def shifted(typingctx, number, value):  # type: ignore[no-untyped-def]
    """The value plus a number, the derivatives as they are."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _with_first(builder, arguments[0], builder.fadd(_first(builder, arguments[0]), arguments[1]))

    return number(number, types.float64), build


@intrinsic
def chained(typingctx, number, value, slope):  # type: ignore[no-untyped-def]
    """f(x) from the value f and its derivative f' at x: the chain rule."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector, value, slope = arguments
        return _with_first(builder, builder.fmul(vector, splat(builder, slope, number.lanes), flags=FUSED), value)

    return number(number, types.float64, types.float64), build


@intrinsic
def _sum(typingctx, a, b):  # type: ignore[no-untyped-def]
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fadd(*arguments, flags=FUSED)

    return a(a, b), build


@intrinsic
def _difference(typingctx, a, b):  # type: ignore[no-untyped-def]
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fsub(*arguments, flags=FUSED)

    return a(a, b), build


@intrinsic
def combined(typingctx, a, b, value, slope_a, slope_b):  # type: ignore[no-untyped-def]
    """f(a, b) from its value and both partial derivatives."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, value, slope_a, slope_b = arguments
        left = builder.fmul(first, splat(builder, slope_a, a.lanes), flags=FUSED)
        right = builder.fmul(second, splat(builder, slope_b, a.lanes), flags=FUSED)
        return _with_first(builder, builder.fadd(left, right, flags=FUSED), value)

    return a(a, b, types.float64, types.float64, types.float64), build


def _is_dual(kind: Any) -> bool:
    return isinstance(kind, Dual)


def _is_number(kind: Any) -> bool:
    return isinstance(kind, types.Number)


@_overload(operator.add)
@_overload(operator.iadd)
def _add(a: Any, b: Any) -> Any:
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: _sum(a, b)
    if _is_dual(a) and _is_number(b):
        return lambda a, b: shifted(a, b)
    if _is_number(a) and _is_dual(b):
        return lambda a, b: shifted(b, a)
    return None


@_overload(operator.sub)
@_overload(operator.isub)
def _subtract(a: Any, b: Any) -> Any:
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: _difference(a, b)
    if _is_dual(a) and _is_number(b):
        return lambda a, b: shifted(a, -b)
    if _is_number(a) and _is_dual(b):
        return lambda a, b: shifted(scaled(b, -1.0), a)
    return None


@_overload(operator.mul)
@_overload(operator.imul)
def _multiply(a: Any, b: Any) -> Any:
    if _is_dual(a) and _is_dual(b):
        return lambda a, b: combined(a, b, value_of(a) * value_of(b), value_of(b), value_of(a))
    if _is_dual(a) and _is_number(b):
        return lambda a, b: scaled(a, b)
    if _is_number(a) and _is_dual(b):
        return lambda a, b: scaled(b, a)
    return None


@_overload(operator.truediv)
@_overload(operator.itruediv)
def _divide(a: Any, b: Any) -> Any:
    if _is_dual(a) and _is_dual(b):

        def divide(a: Any, b: Any) -> Any:
            inverse = 1.0 / value_of(b)
            ratio = value_of(a) * inverse
            return combined(a, b, ratio, inverse, -ratio * inverse)

        return divide
    if _is_dual(a) and _is_number(b):
        return lambda a, b: scaled(a, 1.0 / b)
    if _is_number(a) and _is_dual(b):

        def reciprocal(a: Any, b: Any) -> Any:
            inverse = 1.0 / value_of(b)
            return chained(b, a * inverse, -a * inverse * inverse)

        return reciprocal
    return None


@_overload(operator.neg)
def _negative(a: Any) -> Any:
    return (lambda a: scaled(a, -1.0)) if _is_dual(a) else None


def _compared(compare: Callable[[Any, Any], bool]) -> None:
    def implementation(a: Any, b: Any) -> Any:
        if _is_dual(a) and _is_dual(b):
            return lambda a, b: compare(value_of(a), value_of(b))
        if _is_dual(a) and _is_number(b):
            return lambda a, b: compare(value_of(a), b)
        if _is_number(a) and _is_dual(b):
            return lambda a, b: compare(a, value_of(b))
        return None

    _overload(compare)(implementation)


for _comparison in (operator.lt, operator.le, operator.gt, operator.ge):
    _compared(_comparison)


@intrinsic
def dual_rows(typingctx, array, lanes):  # type: ignore[no-untyped-def]
    """A C-contiguous array (numbers, lanes) seen as a vector of dual numbers; lanes: a literal number."""
    if not isinstance(lanes, types.IntegerLiteral):
        return None
    rows = DualRows(lanes.literal_value)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        result = cgutils.create_struct_proxy(rows)(context, builder)
        result.data = view.data
        result.count = builder.extract_value(view.shape, 0)
        return result._getvalue()

    return rows(array, lanes), build


def lanes_for(derivatives: int) -> int:
    """Lanes of a dual number with so many derivatives: a power of two, as the machine's registers are."""
    return int(2 ** math.ceil(math.log2(1 + derivatives)))


def seeding(lanes: int, slots: tuple[int, ...]) -> Callable[[Any], Any]:
    """A compiled function from a named tuple of numbers to the same of dual numbers: entry i has its derivative, 1, in
    lane slots[i]; where that is 0 it stays a plain number. Where all are it is what it was.
    """
    if not any(slots):
        return inner(lambda numbers: numbers)  # type: ignore[no-any-return]

    @intrinsic
    def seeded(typingctx, numbers):  # type: ignore[no-untyped-def]
        members = [Dual(lanes) if slot else types.float64 for slot in slots]
        kind = types.BaseTuple.from_types(members, numbers.instance_class)

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            entries = []
            for index, slot in enumerate(slots):
                value = builder.extract_value(arguments[0], index)
                if slot:
                    unit = ir.Constant(vector(lanes), [float(lane == slot) for lane in range(lanes)])
                    value = _with_first(builder, unit, value)
                entries.append(value)
            return context.make_tuple(builder, kind, entries)

        return kind(numbers), build

    return seeded  # type: ignore[no-any-return]


def _place(context: Any, builder: Any, rows: DualRows, value: Any, index: Any) -> Any:
    view = cgutils.create_struct_proxy(rows)(context, builder, value=value)
    at = builder.gep(view.data, [builder.mul(index, ir.Constant(index.type, rows.lanes))])
    return builder.bitcast(at, vector(rows.lanes).as_pointer())


@intrinsic
def _load(typingctx, rows, index):  # type: ignore[no-untyped-def]
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(context, builder, rows, *arguments), align=8)

    return Dual(rows.lanes)(rows, types.intp), build


@intrinsic
def _store(typingctx, rows, index, number):  # type: ignore[no-untyped-def]
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _place(context, builder, rows, *arguments[:2]), align=8)
        return context.get_dummy_value()

    return types.void(rows, types.intp, Dual(rows.lanes)), build


@intrinsic
def _count(typingctx, rows):  # type: ignore[no-untyped-def]
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return cgutils.create_struct_proxy(rows)(context, builder, value=arguments[0]).count

    return types.intp(rows), build


@intrinsic
def _picked(typingctx, numbers, index):  # type: ignore[no-untyped-def]
    """One of a tuple of dual and plain numbers."""
    dual = next(kind for kind in numbers if _is_dual(kind))

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        members = [
            context.cast(builder, builder.extract_value(arguments[0], k), kind, dual) for k, kind in enumerate(numbers)
        ]
        found = members[0]
        for k, member in enumerate(members):
            here = builder.icmp_signed("==", arguments[1], ir.Constant(arguments[1].type, k))
            found = builder.select(here, member, found)
        return found

    return dual(numbers, types.intp), build


@_overload(operator.getitem)
def _get(numbers: Any, index: Any) -> Any:
    if isinstance(numbers, DualRows):
        return lambda numbers, index: _load(numbers, index)
    if isinstance(numbers, types.Tuple) and any(_is_dual(kind) for kind in numbers):
        return lambda numbers, index: _picked(numbers, index)
    return None


@_overload(operator.setitem)
def _set(rows: Any, index: Any, number: Any) -> Any:
    return (lambda rows, index, number: _store(rows, index, number)) if isinstance(rows, DualRows) else None


@_overload(len)
def _length(rows: Any) -> Any:
    return (lambda rows: _count(rows)) if isinstance(rows, DualRows) else None


def _plain(name: str) -> Callable[..., Any]:
    """Stands for an operation until the compiler replaces it."""

    def operation(*numbers: Any) -> Any:
        raise NotImplementedError(f"{name} of dual numbers exists in compiled code only")

    return operation


exp, tanh, sqrt, absolute, minimum, maximum = map(_plain, ("exp", "tanh", "sqrt", "absolute", "minimum", "maximum"))


@_overload(exp)
def _exp(x: Any) -> Any:
    if _is_dual(x):

        def of_dual(x: Any) -> Any:
            f = math.exp(value_of(x))
            return chained(x, f, f)

        return of_dual
    return lambda x: math.exp(x)


@_overload(tanh)
def _tanh(x: Any) -> Any:
    if _is_dual(x):

        def of_dual(x: Any) -> Any:
            f = math.tanh(value_of(x))
            return chained(x, f, 1.0 - f * f)

        return of_dual
    return lambda x: math.tanh(x)


@_overload(sqrt)
def _sqrt(x: Any) -> Any:
    if _is_dual(x):

        def of_dual(x: Any) -> Any:
            f = math.sqrt(value_of(x))
            return chained(x, f, 0.5 / f)

        return of_dual
    return lambda x: math.sqrt(x)


@_overload(absolute)
def _absolute(x: Any) -> Any:
    if _is_dual(x):
        return lambda x: scaled(x, math.copysign(1.0, value_of(x)))
    return lambda x: abs(x)


@_overload(minimum)
def _minimum(a: Any, b: Any) -> Any:
    return lambda a, b: a if a < b else b


@_overload(maximum)
def _maximum(a: Any, b: Any) -> Any:
    return lambda a, b: a if a > b else b


@inner
def _select(condition: Any, if_true: Any, if_false: Any) -> Any:
    return if_true if condition else if_false


def _perceptron(network: Perceptron) -> Any:
    """network(z, w) of dual features: one pass forward, one back for the gradient, then the chain rule."""
    forward, output = passes(network).forward, passes(network).output
    gradient, values, features = passes(network).gradient, passes(network).values, network.widths[0]
    scratch = registers.scratch

    def evaluate(z: Any, w: Any) -> Any:
        memory, slopes = scratch(values), scratch(features)
        for j in range(features):
            memory[j] = value_of(z[j])
        forward(w, memory)
        gradient(w, memory, 0, slopes)
        total = chained(z[0], output(w, memory, 0), slopes[0])
        for j in range(1, features):
            total = combined(total, z[j], value_of(total), 1.0, slopes[j])
        return total

    return inner(evaluate)


def linearised(smoothing: float) -> Operations:
    """Operations on dual numbers; ``saturate`` has its corners rounded over ``smoothing`` as in the symbolic form."""
    squared = smoothing * smoothing

    @inner
    def rounded(x: Any, limit: Any) -> Any:
        above, below = x + limit, x - limit
        return 0.5 * (sqrt(above * above + squared) - sqrt(below * below + squared))

    @inner
    def cornered(x: Any, limit: Any) -> Any:
        return maximum(minimum(x, limit), -limit)

    return Operations(
        function=inner,
        exp=exp,
        tanh=tanh,
        sqrt=sqrt,
        absolute=absolute,
        minimum=minimum,
        maximum=maximum,
        select=_select,
        saturate=cornered if smoothing == 0.0 else rounded,
        perceptron=_perceptron,
    )
