"""Calls of compiled functions by their addresses, so that loops around them are compiled once for all systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import cfunc, types
from numba.extending import intrinsic

from hybrid_sysid_ros.core.compilation import inner, is_kept
from hybrid_sysid_ros.core.registers import address_of

__all__ = ["JACOBIAN", "VALUE", "call_jacobian", "call_value", "compiled", "inner", "pointer"]

_NUMBERS = types.CPointer(types.float64)
VALUE = types.void(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, types.float64, types.float64, _NUMBERS)
"""function(x, u, p, w, h, s, out): x (states,), u (inputs,), p (parameters,), w (weights,), h the step [s], s the
smoothing; ``out`` receives the states after the step, or the outputs. No two arrays may share memory.
"""
JACOBIAN = types.void(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, types.float64, types.float64, _NUMBERS, _NUMBERS)
"""function(x, u, p, w, h, s, out, jacobian), with derivatives along rows; see :class:`~.printing.JacobianColumns`."""


def compiled(signature: Any) -> Callable[[Any], Any]:
    """Decorate a function that is called by its address: it is compiled at once, or loaded from the cache on disk."""
    options = {"error_model": "numpy", "fastmath": {"contract"}}
    return cfunc(signature, cache=is_kept(), **options)  # type: ignore[no-any-return]


@intrinsic
def pointer(typingctx, array):  # type: ignore[no-untyped-def]
    """The address of the first number of a contiguous array."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return address_of(context, builder, signature.args[0], arguments[0])

    return _NUMBERS(array), build


def _by_address(arrays: int, more: int) -> Any:
    """The compiler's code for a call with ``arrays`` arrays, then h and s, then ``more`` arrays."""

    def typed(typingctx: Any, address: Any, *arguments: Any) -> Any:
        for kind in (*arguments[:arrays], *arguments[arrays + 2 :]):
            whole = isinstance(kind, types.Array) and kind.layout == "C" and kind.dtype == types.float64
            if not whole and kind != _NUMBERS:
                raise TypeError(f"a call by address takes contiguous arrays of numbers, not {kind}")

        def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            double, pointer = ir.DoubleType(), ir.DoubleType().as_pointer()
            kinds = [pointer] * arrays + [double] * 2 + [pointer] * more
            target = ir.FunctionType(ir.VoidType(), kinds)
            function = builder.inttoptr(values[0], target.as_pointer())
            given = []
            for kind, value in zip(signature.args[1:], values[1:], strict=True):
                given.append(value if isinstance(kind, types.Float) else address_of(context, builder, kind, value))
            builder.call(function, given)
            return context.get_dummy_value()

        middle = (types.float64, types.float64)
        return types.void(types.int64, *arguments[:arrays], *middle, *arguments[arrays + 2 :]), build

    return typed


@intrinsic
def call_value(typingctx, address, x, u, p, w, h, s, out):  # type: ignore[no-untyped-def]
    """Call a function of the signature VALUE; the arrays are contiguous arrays of numbers."""
    return _by_address(4, 1)(typingctx, address, x, u, p, w, h, s, out)


@intrinsic
def call_jacobian(typingctx, address, x, u, p, w, h, s, out, jacobian):  # type: ignore[no-untyped-def]
    """Call a function of the signature JACOBIAN; the arrays are contiguous arrays of numbers."""
    return _by_address(4, 2)(typingctx, address, x, u, p, w, h, s, out, jacobian)
