"""Layout: where the numbers of a serialised message (CDR) are, so that numpy reads or writes a column at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

HEADER = 4  # bytes of encapsulation before the message; alignment counts from their end
NUMBERS = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "<u2", "int16": "<i2",
    "uint32": "<u4", "int32": "<i4", "uint64": "<u8", "int64": "<i8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip


class UnknownLayoutError(ValueError):
    """The message is not little-endian plain CDR, or has a type without a fixed size here."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where one number is: offset [bytes] in the message and its numpy type."""

    offset: int
    dtype: str

    def read(self, rows: NDArray[np.uint8]) -> NDArray[Any]:
        """Column of that number out of messages (messages, bytes)."""
        size = np.dtype(self.dtype).itemsize
        return np.ascontiguousarray(rows[:, self.offset : self.offset + size]).view(self.dtype)[:, 0]

    def write(self, rows: NDArray[np.uint8], column: NDArray[Any]) -> None:
        """Put a column (messages,) into messages (messages, bytes)."""
        size = np.dtype(self.dtype).itemsize
        values = np.ascontiguousarray(column.astype(self.dtype)).view(np.uint8).reshape(len(rows), size)
        rows[:, self.offset : self.offset + size] = values


@dataclass(frozen=True, kw_only=True)
class Places:
    """A list of numbers that follow one another."""

    offset: int
    dtype: str
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Place:
        return Place(offset=self.offset + index * np.dtype(self.dtype).itemsize, dtype=self.dtype)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """One message's structure.

    fields: the message as nested mappings and lists, with Place and Places for its numbers and text as it is.
    fixed: bytes whose value makes the structure (lengths, text): messages that agree in them share the layout.
    """

    fields: dict[str, Any]
    fixed: NDArray[np.intp]

    @classmethod
    def of(cls, raw: bytes, message_type: str, typestore: Typestore) -> Layout:
        """Layout of a serialised message.

        Raises:
            UnknownLayoutError: it is big-endian, cut short or has text of two bytes a letter.
        """
        if len(raw) < HEADER or bytes(raw[:2]) != b"\x00\x01":
            raise UnknownLayoutError("not little-endian plain CDR")
        walk = _Walk(raw, typestore)
        fields = walk.message(message_type)
        return cls(fields=fields, fixed=np.array([0, 1, *walk.fixed], dtype=np.intp))

    def shared_by(self, rows: NDArray[np.uint8]) -> bool:
        """Whether all messages (messages, bytes) have the structure of the first."""
        return not (rows != rows[0]).any(axis=0)[self.fixed].any()


def stacked(messages: Sequence[bytes]) -> NDArray[np.uint8] | None:
    """Messages of one length as (messages, bytes), None if their lengths differ."""
    size = len(messages[0])
    if set(map(len, messages)) != {size}:
        return None
    return np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), size)


class _Walk:
    """One pass over a serialised message, in the order of the definition of its type."""

    def __init__(self, raw: bytes, typestore: Typestore) -> None:
        self.raw = raw
        self.typestore = typestore
        self.position = HEADER
        self.fixed: list[int] = []

    def message(self, message_type: str) -> dict[str, Any]:
        if message_type not in self.typestore.fielddefs:
            raise UnknownLayoutError(f"type {message_type}")
        return {name: self.field(kind) for name, kind in self.typestore.fielddefs[message_type][1]}

    def field(self, kind: Any) -> Any:
        node, detail = kind
        if node == Nodetype.NAME:
            return self.message(detail)
        if node == Nodetype.BASE:
            return self.text() if detail[0] == "string" else self.numbers(detail[0], 1)[0]
        entry, count = detail
        if node == Nodetype.SEQUENCE:
            count = self.length()
        if entry[0] == Nodetype.BASE and entry[1][0] != "string":
            return self.numbers(entry[1][0], count)
        return [self.field(entry) for _ in range(count)]

    def numbers(self, name: str, count: int) -> Places:
        if name not in NUMBERS:
            raise UnknownLayoutError(f"type {name}")
        dtype = NUMBERS[name]
        size = np.dtype(dtype).itemsize
        if count:
            self.align(size)
        places = Places(offset=self.position, dtype=dtype, count=count)
        self.advance(size * count)
        return places

    def length(self) -> int:
        self.align(4)
        start = self.position
        self.advance(4)
        self.fixed.extend(range(start, start + 4))
        return int.from_bytes(self.raw[start : start + 4], "little")

    def text(self) -> str:
        count = self.length()
        start = self.position
        self.advance(count)
        self.fixed.extend(range(start, start + count))
        return bytes(self.raw[start : start + count]).rstrip(b"\x00").decode("utf-8", "replace")

    def align(self, size: int) -> None:
        self.position += -(self.position - HEADER) % size

    def advance(self, size: int) -> None:
        self.position += size
        if self.position > len(self.raw):
            raise UnknownLayoutError("the message is cut short")
