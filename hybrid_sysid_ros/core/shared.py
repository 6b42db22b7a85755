"""Many arrays for compiled code, passed by one address.

numba passes a tuple of arrays as all their sizes and strides, also between compiled functions: hundreds of numbers,
which cost more compile time than the computations. The address of a list of addresses is one number.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, models, register_model, unbox
from numba.np.arrayobj import make_array, populate_array

_WORD = ir.IntType(64)


class SharedType(types.Type):  # type: ignore[misc]
    """The type of a :class:`Shared` in compiled code, with names and types of its members."""

    def __init__(self, owner: str, members: tuple[tuple[str, types.Type], ...]) -> None:
        self.members = members
        super().__init__(f"{owner}({', '.join(f'{name}: {kind}' for name, kind in members)})")

    def place(self, name: str) -> tuple[int, types.Type]:
        """The index of a member's first word, and its type."""
        at = 0
        for other, kind in self.members:
            if other == name:
                break
            at += 1 + (kind.ndim if isinstance(kind, types.Array) else 0)
        return at, kind


class Shared:
    """Base of data classes of contiguous arrays, numbers and other such data classes, none of which is ever replaced.

    Python and compiled code read the same memory by the same names. Compiled code must not keep such an object beyond
    the call, because it does not count references to the arrays. Raises ValueError for other members.
    """

    address: int
    """Address of the list that compiled code reads."""

    def __post_init__(self) -> None:
        words: list[int] = []
        members = []
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            if isinstance(value, Shared):
                words.append(value.address)
            elif isinstance(value, np.ndarray):
                if not value.flags.c_contiguous:
                    raise ValueError(f"{type(self).__name__}: {item.name} is no contiguous array")
                words += [value.ctypes.data, *value.shape]
            else:
                words.append(int(np.array(value).view(np.int64)))
            members.append((item.name, typeof(value)))
        block = np.array(words, dtype=np.int64)
        own: Any = self.__dict__  # a frozen data class
        own["_block"], own["address"] = block, block.ctypes.data
        own["_numba_type_"] = SharedType(f"{type(self).__module__}.{type(self).__name__}", tuple(members))


@register_model(SharedType)
class _Model(models.OpaqueModel):  # type: ignore[misc]
    """A shared object as an address."""


@unbox(SharedType)
def _unbox(kind: Any, given: Any, c: Any) -> NativeValue:
    number = c.pyapi.object_getattr_string(given, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(address, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    key = SharedType

    def generic_resolve(self, kind: SharedType, name: str) -> Any:
        return dict(kind.members).get(name)


@lower_getattr_generic(SharedType)
def _member(context: Any, builder: Any, kind: SharedType, value: Any, name: str) -> Any:
    at, member = kind.place(name)
    words = builder.bitcast(value, _WORD.as_pointer())

    def word(index: int) -> Any:
        found = builder.load(builder.gep(words, [ir.Constant(_WORD, index)]))
        found.set_metadata("invariant.load", builder.module.add_metadata([]))  # sizes and places stay
        return found

    if isinstance(member, SharedType):
        return builder.inttoptr(word(at), value.type)
    if isinstance(member, types.Integer):
        return word(at)
    if isinstance(member, types.Float):
        return builder.bitcast(word(at), ir.DoubleType())
    array = make_array(member)(context, builder)
    size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(member.dtype)))
    shape = [word(at + 1 + axis) for axis in range(member.ndim)]
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(
        array,
        data=builder.inttoptr(word(at), array.data.type),
        shape=cgutils.pack_array(builder, shape),
        strides=cgutils.pack_array(builder, strides),
        itemsize=size,
        meminfo=None,
    )
    return array._getvalue()
