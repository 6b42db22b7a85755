"""Tables: the last rows of what a rig says, in memory that is there from the start, and the frames that pages take."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.support.arrays import Array

ALIGNMENT = 8
"""Of the numbers in a frame [bytes]."""
RESTART, JUMP = 1.0, 10.0
"""A time so far before, and so far after the last one begins anew [s]: a clock that was set is no axis."""


class Table:
    """The last ``capacity`` rows of so many columns; a row's number is how many came before it."""

    def __init__(self, columns: int, capacity: int) -> None:
        self.count = 0
        self.first = 0
        """Number of the first row that is still of use."""
        self._rows = np.full((capacity, columns), np.nan)

    def add(self, row: Sequence[float]) -> None:
        """A row (columns,) more."""
        self._rows[self.count % len(self._rows)] = row
        self.count += 1

    def since(self, number: int) -> Array:
        """Rows from a number on (rows, columns), as far as they are there."""
        capacity = len(self._rows)
        begin = max(number, self.first, self.count - capacity)
        return self._rows[np.arange(begin, max(self.count, begin)) % capacity]


@dataclass(kw_only=True)
class Cursor:
    """How far a page has read."""

    epoch: int = -1
    rows: dict[str, int] = field(default_factory=dict)
    """By table: the number of the next row."""
    latest: dict[str, int] = field(default_factory=dict)
    """By name: which one of those that replace one another."""


class Tables:
    """Tables that grow by rows, arrays of which the newest counts, and texts likewise. Times are in seconds since the
    first row; where they go back by RESTART, or leap by JUMP, a new epoch begins, without what was before.
    """

    def __init__(self, columns: Mapping[str, int], *, capacity: int) -> None:
        """columns: of each table, by its name; the first one is the time."""
        self.tables = {name: Table(count, capacity) for name, count in columns.items()}
        self.epoch = 0
        self.zero: int | None = None
        """Stamp of time 0 [ns]."""
        self._newest = 0
        self._latest: dict[str, tuple[int, Any]] = {}

    def time(self, stamp: int, *, leads: bool = False) -> float:
        """Seconds since the first stamp [ns] of an epoch, NaN for one of another epoch; leads: such stamps tell where a
        new one begins.
        """
        near = self.zero is not None and -RESTART <= (stamp - self._newest) * 1e-9 <= JUMP
        if not near and self.zero is not None and not leads:
            return math.nan
        if not near:
            self.epoch += self.zero is not None
            self.zero = self._newest = stamp
            for table in self.tables.values():
                table.first = table.count
            self._latest = {name: item for name, item in self._latest.items() if not isinstance(item[1], np.ndarray)}
        if leads:
            self._newest = max(self._newest, stamp)
        return (stamp - (self.zero or 0)) * 1e-9

    def replace(self, name: str, value: Any) -> None:
        """An array (rows, columns) or plain data instead of the one before."""
        number = self._latest[name][0] + 1 if name in self._latest else 0
        self._latest[name] = number, np.array(value, dtype=float) if isinstance(value, np.ndarray) else value

    def frame(self, cursor: Cursor, **head: object) -> bytes:
        """What is new since a cursor, which moves on: a head, and the numbers that it names one after the other.

        Four bytes, little-endian, are the length of the head, JSON in UTF-8: ``epoch``; ``tables`` and ``latest`` with
        name, rows and columns of each array; ``news``, plain data by name. The numbers are little-endian float64.
        """
        if cursor.epoch != self.epoch:
            cursor.epoch, cursor.rows = self.epoch, {}
        arrays: list[Array] = []
        listed: dict[str, list[tuple[str, int, int]]] = {"tables": [], "latest": []}
        news = {}
        for name, table in self.tables.items():
            rows = table.since(cursor.rows.get(name, 0))
            cursor.rows[name] = table.count
            if len(rows):
                listed["tables"].append((name, *rows.shape))
                arrays.append(rows)
        for name, (number, value) in self._latest.items():
            if cursor.latest.get(name) == number:
                continue
            cursor.latest[name] = number
            if isinstance(value, np.ndarray):
                listed["latest"].append((name, *value.shape))
                arrays.append(value)
            else:
                news[name] = value
        return packed({"epoch": self.epoch, **listed, "news": news, **head}, arrays)


def packed(head: Mapping[str, object], arrays: Sequence[ArrayLike]) -> bytes:
    """A frame."""
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % ALIGNMENT)
    return b"".join((len(text).to_bytes(4, "little"), text, *(np.asarray(a, dtype="<f8").tobytes() for a in arrays)))


def unpacked(frame: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """A frame's head and its arrays by name: what the page does, for other readers."""
    begin = 4 + int.from_bytes(frame[:4], "little")
    head = json.loads(frame[4:begin])
    arrays = {}
    for name, rows, columns in (*head["tables"], *head["latest"]):
        end = begin + 8 * rows * columns
        arrays[name] = np.frombuffer(frame[begin:end], dtype="<f8").reshape(rows, columns)
        begin = end
    return head, arrays
