"""Command interface: where commands are given, whether a loop runs or not, and how they are answered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, kw_only=True)
class Reply:
    """The answer to a command."""

    text: str
    accepted: bool
    line: str
    """What will happen, or why not."""
    values: Mapping[str, float] = field(default_factory=dict)
    """The same in numbers, by name and unit."""


class CommandInterface(Protocol):
    """Takes commands and answers them; every one passes the same checks."""

    def say(self, text: str) -> Reply:
        """Carry a command out, if it passes."""
        ...

    def check(self, text: str) -> Reply:
        """What a command would come to; nothing moves."""
        ...

    def stop(self) -> Reply:
        """Inputs to rest, now."""
        ...
