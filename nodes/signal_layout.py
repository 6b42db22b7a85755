"""Layout: places of a system's states, inputs and outputs in the messages of its rig's joints."""

from __future__ import annotations

import math
from collections.abc import Iterable, MutableSequence, Sequence
from dataclasses import dataclass
from typing import TypeVar

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs.rig import BEYOND, Rig
from hybrid_sysid_ros.support.errors import UserError

FIELDS = ("position", "velocity", "effort")
"""The lists of a joint message."""
Lists = Sequence[Sequence[float]]
"""These lists in order, each with a number for each entry, or empty."""
T = TypeVar("T")
AHEAD = "_ahead"
"""Suffix of the entries of the state at which the next command will act."""
APPLIED = "_applied"
"""Suffix of the entries of the inputs that acted until the measurement."""
VALIDITY = ("doubt", "sensors_left_out", "input_reversed")
"""Entries on the validity of an estimate: the strongest evidence against it as a multiple of its threshold, the number
of sensors that are left out and of inputs that act with the other sign, and the index of such an input, or -1."""


@dataclass(frozen=True)
class SignalPlace:
    """Place of a number in a message."""

    entry: str
    """Name of a joint or of another entry."""
    field: str
    """position, velocity or effort."""

    def ending(self, ending: str) -> SignalPlace:
        """The same field of the entry with a suffix."""
        return SignalPlace(self.entry + ending, self.field)


class SignalLayout:
    """Places of a system's states (n,), inputs (m,) and outputs (p,); the system is the rig's, or a model of it.

    A joint of the rig carries the variables that ``joints`` in its file declares. A variable without a joint, such as a
    hidden state or an output that is no motion, has an entry with its name, and its value as position.
    """

    def __init__(self, rig: Rig, system: System) -> None:
        """Raises UserError where a state has the name of a joint that does not carry it."""
        joints = rig.joints.joints
        carried = {
            getattr(joint, field): SignalPlace(name, field)
            for name, joint in joints.items()
            for field in ("position", "velocity")
            if getattr(joint, field)
        }
        taken = {name + ending for name in joints for ending in ("", AHEAD, APPLIED)} | {*VALIDITY}
        for item in (*system.states, *system.outputs):
            if item.name not in carried and item.name in taken:
                raise UserError(
                    f"rig {rig.name}: {item.name} is a state or output, and also a joint that does not carry "
                    "it or of what estimates say of their validity: rename one"
                )
        self.inputs = [SignalPlace(*rig.joints.place(item.name)) for item in system.inputs]
        self.states = [carried.get(item.name) or SignalPlace(item.name, "position") for item in system.states]
        self.outputs = [carried.get(item.name) or SignalPlace(item.name, "position") for item in system.outputs]
        names = [item.name for item in system.states]
        self.further = [k for k, item in enumerate(system.outputs) if item.name not in names]
        """Indices of the outputs that are no states."""
        self.validity = [place.ending(APPLIED) for place in self.inputs]
        self.validity += [SignalPlace(name, "position") for name in VALIDITY]
        """Applied inputs, and VALIDITY, (m + 3,)."""

    def estimate(self, followed: Iterable[str]) -> list[SignalPlace]:
        """Places of an estimate: states, outputs that are no states and input disturbances at its stamp, states and
        disturbances when the next command acts, its validity, and the followed parameters.

        Raises UserError where a followed parameter has the name of another entry.
        """
        now = [*self.states, *(self.outputs[k] for k in self.further), *self.inputs]
        later = [place.ending(AHEAD) for place in (*self.states, *self.inputs)]
        later += self.validity
        entries = {place.entry for place in (*now, *later)}
        for name in followed:
            if name in entries:
                raise UserError(f"parameter followed: {name} is also the name of a state or joint; follow another one")
        return [*now, *later, *(SignalPlace(name, "position") for name in followed)]


class Slots:
    """Numbers in their places in successive messages: they are written without a search, and read by name."""

    def __init__(self, places: Sequence[SignalPlace], *, bounds: Sequence[tuple[float, float]] = ()) -> None:
        """bounds: range of the last numbers that is accepted; others must be within the limit of every rig."""
        free = [(-BEYOND, BEYOND)] * (len(places) - len(bounds))
        self.low, self.high = [low for low, _ in (*free, *bounds)], [high for _, high in (*free, *bounds)]
        self.names = list(dict.fromkeys(place.entry for place in places))
        """Entries of a message that has exactly these."""
        self.fields = [field for field in FIELDS if any(place.field == field for place in places)]
        """Lists of such a message."""
        self._places = [(place.entry, FIELDS.index(place.field)) for place in places]
        self._found = self._where(self.names)
        self._read_names: Sequence[str] = self.names
        self._read_found = self._found
        self.named = len(places)
        """Number of slots whose entry was in the last message that was read."""

    def __len__(self) -> int:
        return len(self._places)

    def _where(self, names: Sequence[str]) -> list[tuple[int, int]]:
        index = {name: k for k, name in reversed(list(enumerate(names)))}
        return [(field, index.get(entry, -1)) for entry, field in self._places]

    def write(self, lists: Sequence[MutableSequence[float]], values: Iterable[float]) -> None:
        """Write numbers into the lists of a message for these slots."""
        for (field, index), value in zip(self._found, values, strict=True):
            lists[field][index] = value

    def read(self, names: Sequence[str], lists: Sequence[Sequence[T]]) -> list[T | float]:
        """Entries of a message's lists, NaN where there is none."""
        if names != self._read_names:
            self._read_names, self._read_found = names, self._where(names)
            self.named = sum(index >= 0 for _, index in self._read_found)
        return [
            lists[field][index] if 0 <= index < len(lists[field]) else math.nan for field, index in self._read_found
        ]
