"""Commands: what a rig can be asked for; numbers in the units in which its outputs are shown, times in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Command:
    """One of them."""


@dataclass(frozen=True, kw_only=True)
class Home(Command):
    """All outputs to 0, where the rig works about."""

    pace: str = ""
    seconds: float | None = None
    hold: float = 0.0
    """Seconds that they stay there."""


@dataclass(frozen=True, kw_only=True)
class Repeat(Command):
    """The last commands that were carried out, again."""

    pace: str = ""
    """That their moves take, where one is said."""
    times: int = 1
    seconds: float | None = None
    """For how long, of a swing."""


@dataclass(frozen=True, kw_only=True)
class Undo(Command):
    """Back to where the outputs were asked to be before the last commands, or before those of the same sentence."""

    pace: str = ""
    seconds: float | None = None
    toward: float = 0.0
    """The direction that was said, 1 or -1, 0 where none was."""
    outputs: tuple[int, ...] = ()
    """Those that were named; all where none was."""


@dataclass(frozen=True, kw_only=True)
class Wait(Command):
    """The outputs stay where they are asked to be."""

    seconds: float


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Where an output is to go."""

    output: int
    value: float
    relative: bool = False
    """Whether the value is a change from where it is meant to be then."""
    share: bool = False
    """Whether the value is a factor of that."""
    toward: float = 0.0
    """The direction that was said, 1 or -1, 0 where none was."""
    turned: bool = False
    """Whether the value is backwards, or around from what it is now: one thing unless that is backwards, too."""


@dataclass(frozen=True, kw_only=True)
class Move(Command):
    """Outputs go somewhere, and stay there for ``hold`` [s]. One of pace, seconds and rate at most is given, but for
    "slowly", which the others have to be.
    """

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
    """That shows the goal; "" where it was described."""


@dataclass(frozen=True, kw_only=True)
class Staircase(Command):
    """An output steps from level to level, and stays as long at each. ``end`` or ``count`` is given, and ``rise`` or
    both.
    """

    output: int
    seconds: float
    """At each level."""
    begin: float | None = None
    """The first level; where it is by default, which is then left at once."""
    end: float | None = None
    relative: bool = False
    """Whether the end is a change."""
    rise: float | None = None
    """Of a step, > 0."""
    count: int = 0
    toward: float = 0.0
    """The direction that was said, 1 or -1, 0 where none was."""


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
    """An output swings between two values."""

    output: int
    low: float
    high: float
    frequency: float
    """[Hz]"""
    seconds: float
    shape: str = "sine"
    """"sine": a cosine that begins at ``low``; "square": steps; "triangle": straight lines."""
    last_frequency: float | None = None
    """Of a sine whose frequency grows or falls steadily to this one [Hz]."""
    relative: bool = False
    """The values count from where the output is meant to be then."""
    pace: str = ""
    """"slowly" where that was said, too."""


@dataclass(frozen=True, kw_only=True)
class Adjust(Command):
    """The last swing again, with another "amplitude" or "frequency" [Hz]."""

    noun: str
    value: float
    how: str
    """"to" the value, "by" the value, or "times" the value."""


@dataclass(frozen=True, kw_only=True)
class Follow(Command):
    """One of the rig's own references, or a file."""

    name: str
    path: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What is waited for: a time, that no output moves any more, or that an output reaches a value."""

    delay: float = 0.0
    """[s], where this is all."""
    output: int | None = None
    value: float = 0.0
    side: float = 0.0
    """1 where the output has to be above the value, -1 below, 0 where it comes to it from either side."""

    @property
    def settled(self) -> bool:
        """Whether it is that nothing moves."""
        return not self.delay and self.output is None


def met(condition: Condition, values: Array) -> Array:
    """Outputs (outputs,), as they are shown, of which one has come to the value that a condition waits for."""
    found: Array = values.copy()
    if condition.output is not None and condition.output < len(found):
        found[condition.output] = condition.value
    return found


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """Commands one after the other; ``stops``: at the end the inputs go to rest."""

    text: str
    commands: tuple[Command, ...]
    stops: bool = False
    why: str = ""
    """Why a text that says more is a stop at once; "" where it asks for one."""
    asks: bool = False
    """Whether it is a question, which moves nothing."""
    emergency: bool = False
    """Whether the inputs rest at once and stay there until somebody resets and arms the controller."""
    condition: Condition | None = None
    """Under which ``later`` is carried out, behind these commands, or behind what runs where there are none."""
    later: Sentence | None = None

    @property
    def is_stop(self) -> bool:
        """Whether it asks for nothing but a stop, now."""
        return self.stops and not self.commands and self.later is None

    @property
    def moves(self) -> bool:
        """Whether it asks for anything but a stop."""
        return bool(self.commands) or (self.later is not None and self.later.moves)

    @property
    def because(self) -> str:
        """Why it is a stop at once, behind a reply to it."""
        return f" (what else was said is not done: {self.why})" if self.why else ""

    @property
    def guards(self) -> bool:
        """Whether a stop waits for a value that these commands may pass: it is watched for from their beginning."""
        if not self.commands or self.later is None or self.condition is None:
            return False
        return self.later.is_stop and self.condition.output is not None

    @property
    def ends_in_stop(self) -> bool:
        """Whether it asks for a stop at all, now or in the end."""
        return self.stops or (self.later is not None and self.later.ends_in_stop)
