"""Layout: message types, and the places of numbers in serialised messages (CDR), to read whole columns by numpy."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hybrid_sysid_ros.bags.mcap import DamagedError, Schema
from hybrid_sysid_ros.bags.signals import FieldStep

HEADER = 4  # bytes of encapsulation before the message; alignment counts from their end
NUMBERS = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
MOST_FIELDS = 300_000  # in all layouts that are in memory together; a list of numbers counts as one
DEEPEST = 32  # levels of nested messages
NAME_LISTS = ("name", "joint_names")  # where a message keeps the names of its joints

Types = Mapping[str, Any]
"""Constants and fields of each message type, by its name."""


class UnknownLayoutError(ValueError):
    """The message is not plain CDR of its type; the text says why."""


class MissingFieldError(LookupError):
    """The message lacks the field; the text says which part of the path is missing and which fields there are."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NumberPlace:
    """The place of one number: its offset in the message [bytes] and its numpy type."""

    offset: int
    dtype: np.dtype[Any]

    def read(self, rows: NDArray[np.uint8]) -> NDArray[Any]:
        """The column (messages,) of this number in messages (messages, bytes)."""
        return np.ascontiguousarray(rows[:, self.offset : self.offset + self.dtype.itemsize]).view(self.dtype)[:, 0]

    def write(self, rows: NDArray[np.uint8], column: NDArray[Any]) -> None:
        """Write a column (messages,) into messages (messages, bytes)."""
        values = np.ascontiguousarray(column.astype(self.dtype)).view(np.uint8).reshape(len(rows), self.dtype.itemsize)
        rows[:, self.offset : self.offset + self.dtype.itemsize] = values


@dataclass(frozen=True, kw_only=True, slots=True)
class Places:
    """The place of a list of consecutive numbers."""

    offset: int
    dtype: np.dtype[Any]
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> NumberPlace:
        return NumberPlace(offset=self.offset + index * self.dtype.itemsize, dtype=self.dtype)


@dataclass(frozen=True, kw_only=True)
class MessageLayout:
    """The structure of a message.

    fields: the message as nested mappings and lists, with Place and Places for its numbers and text as it is.
    fixed: bytes that decide the structure (lengths, text): messages that agree in them share the layout.
    count: number of its fields.
    """

    fields: dict[str, Any]
    fixed: NDArray[np.intp]
    count: int

    @classmethod
    def of(cls, raw: bytes, message_type: str, types: Types) -> MessageLayout:
        """Layout of a serialised message.

        Raises UnknownLayoutError for a message that is cut short, or whose type has a size that can't be read.
        """
        if len(raw) < HEADER or bytes(raw[:2]) not in (b"\x00\x00", b"\x00\x01"):
            raise UnknownLayoutError("not plain CDR")
        walk = _Walk(raw, types)
        fields = walk.message(message_type)
        return cls(fields=fields, fixed=np.flatnonzero(np.frombuffer(walk.fixed, dtype=np.uint8)), count=walk.count)


MessageGroup = tuple[NDArray[np.intp], NDArray[np.uint8]]
"""Messages of one length: their numbers (messages,) and bytes (messages, length)."""


def groups_of(messages: Sequence[bytes]) -> list[MessageGroup]:
    """Messages by their lengths."""
    sizes = np.fromiter(map(len, messages), dtype=np.intp, count=len(messages))
    return [
        (alike, np.frombuffer(b"".join(messages[k] for k in alike), dtype=np.uint8).reshape(len(alike), -1))
        for alike in _alike(sizes)
    ]


def sharing(layout: MessageLayout, group: MessageGroup) -> tuple[MessageGroup, Iterator[MessageGroup]]:
    """The messages of a group that share the layout of its first one, and groups of the others."""
    numbers, rows = group
    fixed = rows[:, layout.fixed]
    same = (fixed == fixed[0]).all(axis=1)
    if same.all():
        return group, iter(())
    others = np.flatnonzero(~same)
    _, kinds = np.unique(fixed[others], axis=0, return_inverse=True)
    rest = (others[alike] for alike in _alike(kinds.ravel()))
    return (numbers[same], rows[same]), ((numbers[part], rows[part]) for part in rest)


def field_of(fields: Any, steps: Sequence[FieldStep]) -> Any:
    """Follow a path into the fields of a layout. Raises MissingFieldError where a step leads nowhere."""
    enclosing: list[dict[str, Any]] = []
    node = fields
    for step in steps:
        if not step.attribute:
            node = _entry(node, step, enclosing)
        elif isinstance(node, dict) and step.attribute in node:
            enclosing.append(node)
            node = node[step.attribute]
        else:
            known = f"only {', '.join(node)}" if isinstance(node, dict) else "and no field below"
            raise MissingFieldError(f"there is no {step.attribute}, {known}")
    return node


def _entry(node: Any, step: FieldStep, enclosing: Sequence[dict[str, Any]]) -> Any:
    index = _index_of(step.joint, enclosing) if step.joint else step.index
    if not isinstance(node, list | Places):
        raise MissingFieldError(f"there is no list to take [{step.joint or step.index}] of")
    if index >= len(node):
        raise MissingFieldError(f"the list has {len(node)} entries, so no [{step.joint or index}]")
    return node[index]


def _index_of(joint: str, enclosing: Sequence[dict[str, Any]]) -> int:
    """Index of a joint in the nearest list of names around the field."""
    for node in reversed(enclosing):
        for key in NAME_LISTS:
            if key in node:
                names = [str(name) for name in node[key]]
                if joint not in names:
                    raise MissingFieldError(f"there is no joint {joint!r}, only {', '.join(names) or 'an empty list'}")
                return names.index(joint)
    raise MissingFieldError(f"the message names no joints: write a number in place of [{joint}]")


def _alike(keys: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Indices of equal keys (n,), rising within each."""
    order = np.argsort(keys, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(keys[order])) + 1)


class _Walk:
    """One pass over a serialised message, in the order of the definition of its type."""

    def __init__(self, raw: bytes, types: Types) -> None:
        self.raw = raw
        self.order: Literal["little", "big"] = "little" if raw[1] else "big"
        self.types = types
        self.position = HEADER
        self.fixed = bytearray(len(raw))  # 1 where a byte is
        self.fixed[:2] = b"\1\1"
        self.count = self.depth = 0

    def message(self, message_type: str) -> dict[str, Any]:
        if message_type not in self.types:
            raise UnknownLayoutError(f"the bag does not define the type {message_type}")
        self.depth += 1
        if self.depth > DEEPEST:
            raise UnknownLayoutError(f"{message_type} is nested more than {DEEPEST} levels deep")
        fields = self.types[message_type][1]
        if not fields:  # one byte stands for it, as in C++
            self.advance(1)
        found = {name: self.field(kind) for name, kind in fields}
        self.depth -= 1
        return found

    def field(self, kind: Any) -> Any:
        self.count += 1
        if self.count > MOST_FIELDS:
            raise UnknownLayoutError(f"it has more than {MOST_FIELDS} fields")
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
            raise UnknownLayoutError(f"numbers of type {name} can't be read")
        dtype = np.dtype(NUMBERS[name]).newbyteorder(self.order)
        if count:
            self.align(dtype.itemsize)
        places = Places(offset=self.position, dtype=dtype, count=count)
        self.advance(dtype.itemsize * count)
        return places

    def length(self) -> int:
        self.align(4)
        return int.from_bytes(self.kept(4), self.order)

    def text(self) -> str:
        return self.kept(self.length()).rstrip(b"\x00").decode("utf-8", "replace")

    def kept(self, count: int) -> bytes:
        """The next bytes, which decide the structure."""
        start = self.position
        self.advance(count)
        self.fixed[start : start + count] = b"\1" * count
        return bytes(self.raw[start : start + count])

    def align(self, size: int) -> None:
        self.position += -(self.position - HEADER) % size

    def advance(self, size: int) -> None:
        self.position += size
        if self.position > len(self.raw):
            raise UnknownLayoutError("the message is cut short")


LONGEST = 1 << 18  # characters: the longest of ROS have some 50 000
_SEPARATOR = "=" * 80 + "\n"
_UNREAD = re.compile(r'"(\\.|[^"\\\n])*"|//[^\n]*|/\*.*?\*/', re.DOTALL)  # texts and comments of IDL
_ANNOTATION = re.compile(r"@\s*[\w:]+\s*\([^()]*\)")


@lru_cache(maxsize=256)
def types_of(schema: Schema) -> Types:
    """The message type of a topic and the types in it; those of ROS 2 Jazzy where the bag has no definition.

    Raises DamagedError, or an error of the parsers, where the text is no definition.
    """
    if not schema.text:
        return jazzy_types().fielddefs
    if len(schema.text) > LONGEST:
        raise DamagedError(f"the definition of {schema.name} has {len(schema.text)} characters")
    if schema.encoding == "ros2msg":
        return get_types_from_msg(schema.text, schema.name)
    if schema.encoding not in ("ros2idl", "omgidl"):
        raise DamagedError(f"the definition of {schema.name} is in {schema.encoding}, not in ROS 2's languages")
    found: dict[str, Any] = {}
    for part in schema.text.split(_SEPARATOR):
        text = part.split("\n", 1)[-1] if part.startswith("IDL: ") else part
        if "(" in _ANNOTATION.sub("", _UNREAD.sub("", text)):  # the parser takes 20 s for ((1))
            raise DamagedError(f"the definition of {schema.name} has an expression in parentheses")
        if text.strip():
            found.update(get_types_from_idl(text))
    return found


@lru_cache(maxsize=1)
def jazzy_types() -> Typestore:
    """Message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)
