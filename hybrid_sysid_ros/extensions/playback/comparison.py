"""Comparison: what two bags say under the same stamps, number by number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.bag import Messages, opened
from hybrid_sysid_ros.bags.columns import SECOND, MissingInMessageError, TopicColumns
from hybrid_sysid_ros.bags.layout import MessageLayout
from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

ESTIMATE, COMMAND = "state_estimate", "joint_command"
FIELDS = ("position", "velocity", "effort")
AHEAD = "_ahead"
SETTLED = 1.0  # s after the first message, from which on a loop has forgotten how it began


@dataclass(frozen=True, kw_only=True, eq=False)
class Compared:
    """One number of the messages of a topic, under the stamps that both bags have."""

    topic: str
    field: str
    """Such as position[arm]."""
    unit: str
    time: Array
    """Since the first of these stamps (messages,) [s]."""
    recorded: Array
    replayed: Array

    @cached_property
    def difference(self) -> Array:
        """Replayed minus recorded (messages,); 0 where both are no number, infinite where one is."""
        missing = ~np.isfinite(self.recorded), ~np.isfinite(self.replayed)
        difference = np.where(missing[0] | missing[1], np.inf, self.replayed - self.recorded)
        return np.where(missing[0] & missing[1], 0.0, difference)

    @property
    def largest(self) -> float:
        """Largest difference."""
        return float(np.max(np.abs(self.difference), initial=0.0))

    @property
    def settled(self) -> float:
        """Largest difference from SETTLED on."""
        return float(np.max(np.abs(self.difference[self.time >= SETTLED]), initial=0.0))

    @property
    def rms(self) -> float:
        """Root mean square of the differences."""
        return float(np.sqrt(np.mean(self.difference**2))) if len(self.difference) else 0.0

    @property
    def content(self) -> dict[str, Any]:
        """For JSON."""
        numbers = {"largest": self.largest, f"largest_after_{SETTLED:g}_s": self.settled, "rms": self.rms}
        return {"unit": self.unit, **{name: _plain(value) for name, value in numbers.items()}}


@dataclass(frozen=True, kw_only=True, eq=False)
class ReplayComparison:
    """Estimates and commands of two bags. recorded, replayed, common: stamps by topic, in each and in both."""

    numbers: Sequence[Compared]
    recorded: dict[str, int]
    replayed: dict[str, int]
    common: dict[str, int]

    def of(self, topic: str) -> list[Compared]:
        """The numbers of a topic."""
        return [number for number in self.numbers if number.topic == topic]

    def largest(self, topic: str) -> float:
        """Largest difference of all numbers of a topic."""
        return max((number.largest for number in self.of(topic)), default=0.0)

    @property
    def content(self) -> dict[str, Any]:
        """For JSON."""
        return {
            topic: {
                "recorded": self.recorded[topic],
                "replayed": self.replayed[topic],
                "common": self.common[topic],
                "numbers": {number.field: number.content for number in self.of(topic)},
            }
            for topic in self.common
        }


def compare(recorded: Path, replayed: Path, rig: Rig, *, recover: bool = False) -> ReplayComparison:
    """Compare estimates and commands of two bags of a rig, the first message of each stamp.

    Raises UserError where a topic is missing in one of them or their messages have no number in common.
    """
    names = {topic: f"/{rig.namespace.strip('/')}/{topic}" for topic in (ESTIMATE, COMMAND)}
    bags = []
    for path in (recorded, replayed):
        with opened(path, recover=recover and path == recorded) as bag:
            bags.append(bag.whole(names.values()))
            for name in names.values():
                if name not in bags[-1] or not bags[-1][name].data:
                    raise UserError(f"{path}: no messages of {name}: nothing to compare; the bag has {bag.listing}")
    numbers: list[Compared] = []
    counts: tuple[dict[str, int], ...] = ({}, {}, {})
    for topic, name in names.items():
        first, second = (_Stamped(messages[name]) for messages in bags)
        stamps, here, there = np.intersect1d(first.stamps, second.stamps, return_indices=True)
        for count, found in zip(counts, (first.stamps, second.stamps, stamps), strict=True):
            count[topic] = len(found)
        for field, entry, kind in first.fields:
            if (field, entry, kind) in second.fields:
                numbers.append(
                    Compared(
                        topic=topic,
                        field=field,
                        unit=unit_of(rig, entry, kind),
                        time=np.asarray((stamps - stamps[0]) / SECOND) if len(stamps) else np.zeros(0),
                        recorded=first.values(field, recorded)[here],
                        replayed=second.values(field, replayed)[there],
                    )
                )
    return ReplayComparison(numbers=numbers, recorded=counts[0], replayed=counts[1], common=counts[2])


class _Stamped:
    """Joint messages by their stamps, the first of each."""

    def __init__(self, messages: Messages) -> None:
        self.columns = TopicColumns(messages)
        self.stamps: NDArray[np.int64]
        self.stamps, self._first = np.unique(self.columns.stamps("header.stamp.sec"), return_index=True)
        fields = MessageLayout.of(messages.data[0], messages.type, messages.types).fields
        self.fields = [
            (f"{kind}[{entry}]", str(entry), kind)
            for kind in FIELDS
            for entry in fields["name"]
            if len(fields[kind]) == len(fields["name"])
        ]

    def values(self, field: str, path: Path) -> Array:
        try:
            return self.columns.values(field)[self._first]
        except MissingInMessageError as error:
            topic = self.columns.messages.topic
            raise UserError(f"{path}: topic {topic}: field {field} is missing in {error}") from error


def unit_of(rig: Rig, entry: str, field: str) -> str:
    """Unit of a number of a joint message, "" where the rig does not know it."""
    entry = entry.removesuffix(AHEAD)
    joint = rig.joints.joints.get(entry)
    carried = getattr(joint, field) if joint else entry
    known: list[Variable] = [*rig.system.states, *rig.system.outputs, *rig.system.inputs]
    return next((item.unit for item in known if item.name == carried), "")


def _plain(value: float) -> float | None:
    """A number as JSON has it."""
    return value if np.isfinite(value) else None
