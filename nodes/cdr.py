"""CDR: joint messages as bytes (OMG DDSI-RTPS 2.5, 10.2: plain CDR, little-endian)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from struct import Struct, calcsize

import numpy as np

from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.signal_layout import FIELDS, Lists, Slots

HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options. Alignment counts from the end of this header."""


class MessageTemplate:
    """The common bytes of messages from one source with the same names and numbers of entries in each list: every byte
    except the stamp and the numbers, and the places of these.

    A message that has all common bytes is unpacked by one call; others are not unpacked here.
    """

    def __init__(self, source: str, names: Sequence[str]) -> None:
        """Raises UnicodeEncodeError for text that can't be written."""
        self.source, self.names = source, names
        self._data, self._mask, self._format = bytearray(), bytearray(), "<"
        self._add(HEADER)
        self._take("iI", 4)
        self._add_text(source)
        self._add_number(len(names))
        for name in names:
            self._add_text(name)

    def _add(self, data: bytes) -> None:
        """Add bytes that messages have in common."""
        self._data += data
        self._mask += b"\xff" * len(data)

    def _add_number(self, number: int) -> None:
        self._align(4)
        self._add(number.to_bytes(4, "little"))

    def _add_text(self, text: str) -> None:
        data = text.encode() + b"\0"
        self._add_number(len(data))
        self._add(data)

    def _align(self, size: int) -> None:
        """Skip the padding that aligns the next part to a multiple of its size."""
        self._leave((len(HEADER) - len(self._data)) % size)

    def _leave(self, size: int) -> None:
        """Skip bytes that messages don't have in common."""
        self._data += bytes(size)
        self._mask += bytes(size)

    def _take(self, kinds: str, size: int) -> None:
        """Add numbers of one size each, by their format characters."""
        self._align(size)
        self._format += f"{len(self._data) - calcsize(self._format)}x{kinds}"
        self._leave(calcsize(f"<{kinds}"))

    def _take_list(self, count: int) -> None:
        self._add_number(count)
        if count:
            self._take(f"{count}d", 8)

    def _end(self) -> None:
        """Compile the format, after all parts were added."""
        self._values = Struct(f"{self._format}{len(self._data) - calcsize(self._format)}x")
        self._common = int.from_bytes(self._data, "little")
        self._where = int.from_bytes(self._mask, "little")

    def _numbers(self, data: bytes) -> tuple[float, ...] | None:
        """The numbers of a message of this form; bytes between and after its parts may have any value."""
        if len(data) < self._values.size or int.from_bytes(data, "little") & self._where != self._common:
            return None
        return self._values.unpack_from(data)

    def _message(self, *numbers: float) -> bytes:
        values = self._values.pack(*numbers)
        return (int.from_bytes(values, "little") | self._common).to_bytes(len(values), "little")


class JointForm(MessageTemplate):
    """The form of JointState messages."""

    def __init__(self, source: str, names: Sequence[str], counts: Sequence[int]) -> None:
        """counts: number of entries in each list."""
        super().__init__(source, names)
        self._velocity, self._effort = 2 + counts[0], 2 + counts[0] + counts[1]
        for count in counts:
            self._take_list(count)
        self._end()

    def unpack(self, data: bytes) -> JointStates | None:
        """The content of a message, if it has this form."""
        values = self._numbers(data)
        if values is None:
            return None
        lists = values[2 : self._velocity], values[self._velocity : self._effort], values[self._effort :]
        return JointStates(self.source, int(values[0]) * SECOND + int(values[1]), self.names, lists)

    def pack(self, stamp: int, lists: Lists) -> bytes:
        """A message with this stamp [ns] and these numbers."""
        position, velocity, effort = lists
        return self._message(*divmod(stamp, SECOND), *position, *velocity, *effort)


class TrajectoryForm(MessageTemplate):
    """The form of JointTrajectory messages whose points all have the same lists."""

    def __init__(self, source: str, names: Sequence[str], counts: Sequence[int], points: int) -> None:
        """counts: number of entries in each list of a point, without accelerations, which are not used."""
        super().__init__(source, names)
        position, velocity, effort = counts
        self._columns = 0, position, position + velocity, position + velocity + effort
        self._points = points
        self._add_number(points)
        for _ in range(points):
            for count in (position, velocity, 0, effort):
                self._take_list(count)
            self._take("iI", 4)
        self._end()

    def unpack(self, data: bytes) -> TrajectoryMessage | None:
        """The content of a message, if it has this form."""
        values = self._numbers(data)
        if values is None:
            return None
        *rows, seconds, rest = np.array(values[2:]).reshape(self._points, self._columns[-1] + 2).T
        times = seconds.astype(np.int64) * SECOND + rest.astype(np.int64)
        lists = [rows[begin:end] for begin, end in zip(self._columns, self._columns[1:], strict=False)]
        return TrajectoryMessage(self.source, int(values[0]) * SECOND + int(values[1]), self.names, times, lists)

    def pack(self, stamp: int, numbers: Iterable[float]) -> bytes:
        """The message with this stamp [ns] and, for each point, its numbers, seconds and nanoseconds."""
        return self._message(*divmod(stamp, SECOND), *numbers)


class JointWriter:
    """Writes joint messages with the entries of some slots in order; NaN where there is no slot."""

    def __init__(self, slots: Slots, source: str = "") -> None:
        """source: the frame_id of each message."""
        self._slots, self._lists = slots, _lists(slots)
        self._form = JointForm(source, slots.names, [len(values) for values in self._lists])

    def pack(self, stamp: int, values: Iterable[float]) -> bytes:
        """The message with a stamp [ns] and a value for each slot."""
        self._slots.write(self._lists, values)
        return self._form.pack(stamp, self._lists)


class TrajectoryWriter:
    """Writes trajectories with the entries of some slots in order; NaN where there is no slot."""

    def __init__(self, slots: Slots, offsets: Sequence[int], source: str = "") -> None:
        """offsets: times of the points after the stamp [ns]; source: the frame_id of each message."""
        self._slots, self._lists = slots, _lists(slots)
        counts = [len(values) for values in self._lists]
        self._form = TrajectoryForm(source, slots.names, counts, len(offsets))
        self._times = [divmod(offset, SECOND) for offset in offsets]

    def pack(self, stamp: int, rows: Iterable[Iterable[float]]) -> bytes:
        """The message with a stamp [ns] and, for each point, a value for each slot."""
        numbers: list[float] = []
        for row, time in zip(rows, self._times, strict=True):
            self._slots.write(self._lists, row)
            for values in (*self._lists, time):
                numbers += values
        return self._form.pack(stamp, numbers)


def _lists(slots: Slots) -> tuple[list[float], list[float], list[float]]:
    """The lists of a message with the entries of some slots."""
    position, velocity, effort = ([math.nan] * (len(slots.names) if field in slots.fields else 0) for field in FIELDS)
    return position, velocity, effort
