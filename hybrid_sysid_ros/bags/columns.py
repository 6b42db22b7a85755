"""Columns: a topic's messages as arrays: one field over all messages, with the time each value belongs to."""

from __future__ import annotations

import struct
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from hybrid_sysid_ros.bags.bag import Messages
from hybrid_sysid_ros.bags.fields import MissingFieldError, field_of, has_field
from hybrid_sysid_ros.bags.layout import Layout, Place, UnknownLayoutError, stacked
from hybrid_sysid_ros.bags.signals import Step, parsed_field

SECOND = 1_000_000_000  # ns


class MissingInMessageError(LookupError):
    """A message of the topic has not got the field: its number and what is missing."""


class Columns:
    """Fields of a topic as arrays.

    Where all messages have one layout, as those of a driver do, the numbers are taken out of their bytes at once;
    otherwise each message is deserialised.
    """

    def __init__(self, messages: Messages, typestore: Typestore, *, stamped: bool | None = None) -> None:
        """stamped: whether their headers were ever given a stamp; None: see whether one of these was."""
        self.messages = messages
        self._known_stamped = stamped
        self._typestore = typestore
        self._columns: dict[tuple[Step, ...], NDArray[np.float64]] = {}

    def values(self, field: str) -> NDArray[np.float64]:
        """Field of every message, (messages,).

        Raises:
            MissingInMessageError: a message has not got it, or it is no number.
        """
        return self._column(parsed_field(field))

    def entries(self, field: str) -> int:
        """Number of entries of a list in the first message.

        Raises:
            MissingInMessageError: it has not got it, or it is no list.
        """
        try:
            found = field_of(self._first, parsed_field(field))
        except MissingFieldError as error:
            raise self._missing(0, error) from error
        if not hasattr(found, "__len__") or isinstance(found, str | dict):
            raise self._missing(0, f"{field} is no list")
        return len(found)

    def stamps(self, field: str) -> NDArray[np.int64]:
        """Time that each value belongs to, (messages,) [ns].

        The header's stamp where there is one (and it was ever set), otherwise the time of logging; for a value inside a
        point of a trajectory, later by the point's time_from_start.
        """
        stamps = self._header_stamps if self.stamped else self.messages.logged
        steps = parsed_field(field)
        for end in range(1, len(steps)):
            point = field_of(self._first, steps[:end])
            if not steps[end - 1].attribute and has_field(point, "time_from_start"):
                stamps = stamps + self._nanoseconds((*steps[:end], Step(attribute="time_from_start")))
        return stamps

    @cached_property
    def stamped(self) -> bool:
        """Whether the messages have headers whose stamp was ever set."""
        if self._known_stamped is not None:
            return self._known_stamped
        header = self._first.get("header") if isinstance(self._first, dict) else getattr(self._first, "header", None)
        return header is not None and has_field(header, "stamp") and bool(self._header_stamps.any())

    @cached_property
    def _header_stamps(self) -> NDArray[np.int64]:
        return self._nanoseconds((Step(attribute="header"), Step(attribute="stamp")))

    def _nanoseconds(self, steps: tuple[Step, ...]) -> NDArray[np.int64]:
        whole = self._column((*steps, Step(attribute="sec"))).astype(np.int64)
        return whole * SECOND + self._column((*steps, Step(attribute="nanosec"))).astype(np.int64)

    def _column(self, steps: tuple[Step, ...]) -> NDArray[np.float64]:
        if steps not in self._columns:
            self._columns[steps] = self._read(steps)
        return self._columns[steps]

    def _read(self, steps: tuple[Step, ...]) -> NDArray[np.float64]:
        if self._block is not None:
            layout, rows = self._block
            try:
                place = field_of(layout.fields, steps)
            except MissingFieldError as error:
                raise self._missing(0, error) from error
            if not isinstance(place, Place):
                raise self._missing(0, "the field is no single number")
            return place.read(rows).astype(np.float64)
        column = np.empty(len(self._objects))
        for number, message in enumerate(self._objects):
            try:
                value = field_of(message, steps)
            except MissingFieldError as error:
                raise self._missing(number, error) from error
            if not isinstance(value, int | float | np.number):
                raise self._missing(number, "the field is no single number")
            column[number] = value
        return column

    @cached_property
    def _block(self) -> tuple[Layout, NDArray[np.uint8]] | None:
        rows = stacked(self.messages.data)
        if rows is None:
            return None
        try:
            layout = Layout.of(self.messages.data[0], self.messages.type, self._typestore)
        except UnknownLayoutError:
            return None
        return (layout, rows) if layout.shared_by(rows) else None

    @cached_property
    def _objects(self) -> list[Any]:
        try:
            definition = self._typestore.get_msgdef(self.messages.type)
        except KeyError as error:
            raise self._missing(0, f"the bag does not define the type {error.args[0]}") from error
        objects: list[Any] = []
        for number, raw in enumerate(self.messages.data):
            deserialise = definition.deserialize_cdr_le if raw[1:2] == b"\x01" else definition.deserialize_cdr_be
            try:  # not Typestore.deserialize_cdr, which refuses the spare bytes that rclpy's serialize_message appends
                message, _ = deserialise(memoryview(raw)[4:], 0, definition.cls, self._typestore)
            except (SerdeError, struct.error, ValueError) as error:
                raise self._missing(number, f"it is no {self.messages.type}") from error
            objects.append(message)
        return objects

    @property
    def _first(self) -> Any:
        return self._block[0].fields if self._block is not None else self._objects[0]

    def _missing(self, number: int, reason: object) -> MissingInMessageError:
        return MissingInMessageError(f"message {self.messages.first + number}: {reason}")
