"""Arrays at addresses: how compiled code sees memory whose size depends on the system.

Records hold the addresses, so that their type, and with it the code that is compiled for them, is one for all systems.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array


@intrinsic
def _at(typingctx, address):  # type: ignore[no-untyped-def]
    """A pointer to numbers from an address."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), build


@inner
def numbers_at(address: int) -> Any:
    """The numbers at an address, without a length."""
    return _at(address)


@inner
def vector(address: int, length: int, first: int = 0) -> Array:
    """The array (length,) that begins ``first`` numbers behind an address."""
    return carray(_at(address + 8 * first), (length,))  # type: ignore[no-any-return]


@inner
def matrix(address: int, rows: int, columns: int, first: int = 0) -> Array:
    """The array (rows, columns) that begins ``first`` numbers behind an address."""
    return carray(_at(address + 8 * first), (rows, columns))  # type: ignore[no-any-return]
