"""CDR: joint messages as the bytes that travel (OMG DDSI-RTPS 2.5, 10.2: plain CDR, little-endian)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from struct import Struct, calcsize

from hybrid_sysid_ros.nodes.layout import FIELDS, Lists, Slots
from hybrid_sysid_ros.nodes.messages import SECOND, Joints

HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options. What follows is aligned from here on."""


class Form:
    """What joint messages of one source have in common, with the same names and as many numbers in each list: every
    byte but those of the stamp and the numbers, and where these stand.

    Nothing in a message says where to look: one that has all these bytes is unpacked by one call, others not at all.
    """

    def __init__(self, source: str, names: Sequence[str], counts: Sequence[int]) -> None:
        """counts: numbers in each of the lists. Raises UnicodeEncodeError for text that can't be written."""
        self.source, self.names = source, names
        self._velocity, self._effort = 2 + counts[0], 2 + counts[0] + counts[1]
        common, values = _Common(), f"<{len(HEADER)}xiI"
        common.leave(8)
        common.add_text(source)
        common.add_number(len(names))
        for name in names:
            common.add_text(name)
        for count in counts:
            common.add_number(count)
            if count:
                common.align(8)
                values += f"{len(common.data) - calcsize(values)}x{count}d"
                common.leave(8 * count)
        self._values = Struct(f"{values}{len(common.data) - calcsize(values)}x")
        self._common = int.from_bytes(common.data, "little")
        self._mask = int.from_bytes(common.mask, "little")

    def unpack(self, data: bytes) -> Joints | None:
        """What a message says, if it is of this form. What lies between or after its parts may be anything."""
        if len(data) < self._values.size or int.from_bytes(data, "little") & self._mask != self._common:
            return None
        values = self._values.unpack_from(data)
        lists = values[2 : self._velocity], values[self._velocity : self._effort], values[self._effort :]
        return Joints(self.source, values[0] * SECOND + values[1], self.names, lists)

    def pack(self, stamp: int, lists: Lists) -> bytes:
        """The message with this stamp [ns] and these numbers."""
        position, velocity, effort = lists
        values = self._values.pack(*divmod(stamp, SECOND), *position, *velocity, *effort)
        return (int.from_bytes(values, "little") | self._common).to_bytes(len(values), "little")


class _Common:
    """Bytes that messages have in common, nothing elsewhere; mask: all ones where they stand."""

    def __init__(self) -> None:
        self.data, self.mask = bytearray(), bytearray()
        self.add(HEADER)

    def add(self, data: bytes) -> None:
        self.data += data
        self.mask += b"\xff" * len(data)

    def add_number(self, number: int) -> None:
        self.align(4)
        self.add(number.to_bytes(4, "little"))

    def add_text(self, text: str) -> None:
        data = text.encode() + b"\0"
        self.add_number(len(data))
        self.add(data)

    def align(self, size: int) -> None:
        """Leave out what brings the next part to a multiple of its size."""
        self.leave((len(HEADER) - len(self.data)) % size)

    def leave(self, size: int) -> None:
        """Bytes that messages don't have in common."""
        self.data += bytes(size)
        self.mask += bytes(size)


class JointWriter:
    """Joint messages with the entries of some slots, one after the other; NaN where there is no slot."""

    def __init__(self, slots: Slots, source: str = "") -> None:
        """source: the frame_id of each."""
        counts = [len(slots.names) if field in slots.fields else 0 for field in FIELDS]
        self._slots, self._form = slots, Form(source, slots.names, counts)
        position, velocity, effort = ([math.nan] * count for count in counts)
        self._lists = position, velocity, effort

    def pack(self, stamp: int, values: Iterable[float]) -> bytes:
        """The message with a stamp [ns] and a value for each slot."""
        self._slots.write(self._lists, values)
        return self._form.pack(stamp, self._lists)
