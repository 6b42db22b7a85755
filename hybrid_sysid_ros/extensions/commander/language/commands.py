"""Commands: what a rig can be asked for; numbers in the units in which its outputs are shown, times in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Command:
    """One of them."""


@dataclass(frozen=True, kw_only=True)
class Home(Command):
    """All outputs to 0, where the rig works about."""

    pace: str = ""


@dataclass(frozen=True, kw_only=True)
class Repeat(Command):
    """The last commands that were carried out, again."""


@dataclass(frozen=True, kw_only=True)
class Wait(Command):
    """The outputs stay where they are asked to be."""

    seconds: float


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Where an output is to go; from where it is meant to be then, if it is a change."""

    output: int
    value: float
    relative: bool = False


@dataclass(frozen=True, kw_only=True)
class Move(Command):
    """Outputs go somewhere, and stay there for ``hold`` [s]. One of pace, seconds and rate at most is given."""

    goals: tuple[Goal, ...]
    shape: str
    """"smooth", "straight" or "step"."""
    begin: float | None = None
    """Where the first goal's output goes before."""
    pace: str = ""
    seconds: float | None = None
    rate: float | None = None
    """Of the first goal's output, at most [its unit/s]."""
    hold: float = 0.0
    picture: str = ""
    """That shows the goal; "" where it was told."""


@dataclass(frozen=True, kw_only=True)
class PictureTarget(Command):
    """Where a picture shows the rig; a :class:`Move` once somebody has looked at it."""

    name: str
    path: Path
    pace: str = ""
    seconds: float | None = None
    hold: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Swing(Command):
    """An output swings between two values: as a cosine that begins at the first, or in steps."""

    output: int
    low: float
    high: float
    frequency: float
    """[Hz]"""
    seconds: float
    square: bool = False
    relative: bool = False
    """The values count from where the output is meant to be then."""


@dataclass(frozen=True, kw_only=True)
class Follow(Command):
    """One of the rig's own references, or a file."""

    name: str
    path: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """Commands one after the other; ``stops``: at the end the inputs go to rest."""

    text: str
    commands: tuple[Command, ...]
    stops: bool = False
    emergency: bool = False
    """Whether the inputs rest at once and stay there until somebody resets and arms the controller."""

    @property
    def is_stop(self) -> bool:
        """Whether it asks for nothing but a stop, now."""
        return self.stops and not self.commands
