"""Failsafe: what a loop does about the evidence that it has, step by step, and how it comes back.

The kernels are Python, and are printed as C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from hybrid_sysid_ros.estimation.suspicion import suspicion

AGAIN = 0.5
"""Share of a level's time to which suspicion must have fallen before that level is left again."""
ROOM = 1.25
"""Multiple of the last level's time at which suspicion stops to grow."""
NOTHING = -1
"""The cause of a level without one."""


class LoopState(IntEnum):
    """What a control loop is doing, from the freest to the most restricted."""

    DRIVING = 0
    """The reference is followed."""
    SLOWED = 1
    """The reference moves slowly, and the inputs stay near rest."""
    HOLDING = 2
    """The outputs are held where they are."""
    RESTING = 3
    """The inputs are at rest, or what a rig's own stabiliser makes of it."""
    STOPPED = 4
    """A user has stopped the loop."""
    DISARMED = 5
    """The loop has not been armed, or an emergency stop has disarmed it."""

    @property
    def word(self) -> str:
        """The state in a word, as diagnostics have it."""
        return self.name.lower()


class Ladder(NamedTuple):
    """After how much suspicion each level is entered [s]."""

    slowed: float
    holding: float
    resting: float


@dataclass(slots=True)
class Failsafe:
    """Evidence becomes a level: the suspicion of each kind of evidence climbs the ladder, and the highest counts.

    slowed, holding, resting: the :class:`Ladder`. level: a :class:`LoopState`. cause: the index of the evidence behind
    it.
    """

    slowed: float
    holding: float
    resting: float
    level: int = LoopState.DRIVING
    cause: int = NOTHING


@dataclass(slots=True)
class Evidence:
    """Evidence of one kind, as a multiple of its threshold, the suspicion that it has raised [s], and the highest level
    that it can ask for.
    """

    value: float = 0.0
    seconds: float = 0.0
    worst: int = LoopState.RESTING


def judge_evidence(failsafe: Failsafe, kinds: Sequence[Evidence], elapsed: float) -> int:
    """Take in evidence of the last ``elapsed`` [s]; return the level now.

    A level is entered as soon as suspicion reaches its time and left when it has fallen to AGAIN of that.
    """
    level, most, cause, before = 0, 0.0, NOTHING, failsafe.level
    for k in range(len(kinds)):
        seconds = suspicion(kinds[k].seconds, kinds[k].value, elapsed, ROOM * failsafe.resting)
        kinds[k].seconds = seconds
        asked = min(_asked(failsafe, seconds), kinds[k].worst)
        if asked > level or (asked == level and seconds > most):
            level, most, cause = asked, seconds, k
    if level > before:
        failsafe.cause = cause
    elif level == 0:
        failsafe.cause = NOTHING
    failsafe.level = level
    return level


def _asked(failsafe: Failsafe, seconds: float) -> int:
    """The level that suspicion [s] of one kind asks for."""
    level, before = 0, failsafe.level
    if seconds >= failsafe.slowed * (AGAIN if before >= 1 else 1.0):
        level = 1
    if seconds >= failsafe.holding * (AGAIN if before >= 2 else 1.0):
        level = 2
    if seconds >= failsafe.resting * (AGAIN if before >= 3 else 1.0):
        level = 3
    return level
