"""Columns: a field of all messages of a topic as an array, with the time of each value."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.bag import Messages
from hybrid_sysid_ros.bags.layout import (
    MOST_FIELDS,
    MessageGroup,
    MessageLayout,
    MissingFieldError,
    NumberPlace,
    UnknownLayoutError,
    field_of,
    groups_of,
    sharing,
)
from hybrid_sysid_ros.bags.signals import FieldStep, parsed_field

SECOND = 1_000_000_000  # ns


class MissingInMessageError(LookupError):
    """A message of the topic lacks the field; the text has its number and what is missing."""


class TopicColumns:
    """Fields of a topic as arrays. A number is read at once from all messages that share a layout."""

    def __init__(self, messages: Messages, *, stamped: bool | None = None) -> None:
        """stamped: whether any header of the topic has a stamp; None: look for one in these messages."""
        self.messages = messages
        self._known_stamped = stamped
        self._columns: dict[tuple[FieldStep, ...], NDArray[np.float64]] = {}

    def values(self, field: str) -> NDArray[np.float64]:
        """The field of every message, (messages,).

        Raises MissingInMessageError where a message lacks the field, or it is no number.
        """
        return self._column(parsed_field(field))

    def entries(self, field: str) -> int:
        """Number of entries of a list in the first message.

        Raises MissingInMessageError where the message lacks the field, or it is no list.
        """
        try:
            found = field_of(self._first, parsed_field(field))
        except MissingFieldError as error:
            raise self._missing(0, error) from error
        if not hasattr(found, "__len__") or isinstance(found, str | dict):
            raise self._missing(0, f"{field} is no list")
        return len(found)

    def stamps(self, field: str) -> NDArray[np.int64]:
        """The time of each value, (messages,) [ns].

        It is the header's stamp where stamps are set, otherwise the time of logging. A value in a point of a trajectory
        is later by the point's time_from_start.
        """
        stamps = self._header_stamps if self.stamped else self.messages.logged
        steps = parsed_field(field)
        for end in range(1, len(steps)):
            point = field_of(self._first, steps[:end])
            if not steps[end - 1].attribute and isinstance(point, dict) and "time_from_start" in point:
                stamps = stamps + self._nanoseconds((*steps[:end], FieldStep(attribute="time_from_start")))
        return stamps

    @cached_property
    def stamped(self) -> bool:
        """Whether the messages have headers with a stamp that is set."""
        if self._known_stamped is not None:
            return self._known_stamped
        header = self._first.get("header")
        return isinstance(header, dict) and "stamp" in header and bool(self._header_stamps.any())

    @cached_property
    def _header_stamps(self) -> NDArray[np.int64]:
        return self._nanoseconds((FieldStep(attribute="header"), FieldStep(attribute="stamp")))

    def _nanoseconds(self, steps: tuple[FieldStep, ...]) -> NDArray[np.int64]:
        whole = self._column((*steps, FieldStep(attribute="sec"))).astype(np.int64)
        return whole * SECOND + self._column((*steps, FieldStep(attribute="nanosec"))).astype(np.int64)

    def _column(self, steps: tuple[FieldStep, ...]) -> NDArray[np.float64]:
        if steps not in self._columns:
            self._columns[steps] = self._read(steps)
        return self._columns[steps]

    def _read(self, steps: tuple[FieldStep, ...]) -> NDArray[np.float64]:
        column = np.empty(len(self.messages.data))
        for layout, (numbers, rows) in self._groups:
            try:
                place = field_of(layout.fields, steps)
            except MissingFieldError as error:
                raise self._missing(numbers[0], error) from error
            if not isinstance(place, NumberPlace):
                raise self._missing(numbers[0], "the field is no single number")
            column[numbers] = place.read(rows)
        return column

    @cached_property
    def _groups(self) -> list[tuple[MessageLayout, MessageGroup]]:
        """Messages grouped by layout; the layout of the first message comes first."""
        found, waiting, fields = [], groups_of(self.messages.data), 0
        while waiting:
            group = waiting.pop()
            first = int(group[0][0])
            try:
                layout = MessageLayout.of(self.messages.data[first], self.messages.type, self.messages.types)
            except UnknownLayoutError as error:
                raise self._missing(first, f"it is no {self.messages.type}: {error}") from error
            sharers, others = sharing(layout, group)
            found.append((layout, sharers))
            fields += layout.count
            if fields > MOST_FIELDS:
                raise self._missing(first, f"the layouts of the messages up to it have more than {MOST_FIELDS} fields")
            waiting += others
        return sorted(found, key=lambda item: int(item[1][0][0]))

    @property
    def _first(self) -> dict[str, Any]:
        return self._groups[0][0].fields

    def _missing(self, number: int, reason: object) -> MissingInMessageError:
        return MissingInMessageError(f"message {self.messages.first + number}: {reason}")
