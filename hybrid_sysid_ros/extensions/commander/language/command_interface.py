"""Command interface: where commands are given, whether a loop runs or not, and how they are answered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast


@dataclass(frozen=True, kw_only=True)
class Reply:
    """The answer to a command."""

    text: str
    accepted: bool
    line: str
    """What will happen, or why not."""
    values: Mapping[str, float] = field(default_factory=dict)
    """The same in numbers, by name and unit."""
    forecast: Forecast | None = None
    """The simulation, where it was made here."""


@dataclass(frozen=True, kw_only=True)
class RigState:
    """Where a rig is, by names with units, as they are shown; inputs in SI."""

    live: bool
    """Whether a loop runs; otherwise the rig is at rest."""
    outputs: Mapping[str, float]
    references: Mapping[str, float]
    inputs: Mapping[str, float]
    standstill: str = ""
    """That nothing moves, why, and what to do; "" where references are followed."""


class CommandInterface(Protocol):
    """Takes commands and answers them; every one passes the same checks."""

    def say(self, text: str) -> Reply:
        """Carry a command out, if it passes."""
        ...

    def check(self, text: str) -> Reply:
        """What a command would come to from where the rig is; nothing moves."""
        ...

    def stop(self) -> Reply:
        """Inputs to rest, now."""
        ...

    def state(self) -> RigState:
        """Where the rig is. Raises UserError where nobody says so."""
        ...
