"""Failsafe: what a loop does about the evidence that it has, step by step, and how it comes back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from hybrid_sysid_ros.estimation.suspicion import Suspicion

AGAIN = 0.5
"""Share of a level's time to which suspicion must have fallen before that level is left again."""
ROOM = 1.25
"""Multiple of the last level's time at which suspicion stops to grow."""


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


class Failsafe:
    """Evidence becomes a level: the suspicion of each kind of evidence climbs the ladder, and the highest counts.

    A level is entered as soon as suspicion reaches its time and left when it has fallen to AGAIN of that.

    state: the level now. reason: the name of the evidence behind it, "" while driving. tripped: how often each level
    was entered.
    """

    def __init__(self, ladder: Ladder, names: Sequence[str]) -> None:
        """names: of the kinds of evidence."""
        self.ladder = ladder
        self._suspicions = {name: Suspicion(ROOM * ladder.resting) for name in names}
        self.reset()

    def reset(self) -> None:
        """Forget all suspicion."""
        self.state, self.reason = LoopState.DRIVING, ""
        self.tripped = dict.fromkeys((LoopState.SLOWED, LoopState.HOLDING, LoopState.RESTING), 0)
        for suspicion in self._suspicions.values():
            suspicion.seconds = 0.0

    @property
    def suspicion(self) -> float:
        """The largest of all [s]."""
        return max(suspicion.seconds for suspicion in self._suspicions.values())

    def suspects(self, name: str, level: LoopState) -> bool:
        """Whether a kind of evidence would be enough by itself to stay at a level of the ladder."""
        return self._suspicions[name].seconds >= AGAIN * self.ladder[level - LoopState.SLOWED]

    def go_on(self, other: Failsafe) -> None:
        """Take over the level and the suspicions of another one with the same kinds of evidence."""
        self.state, self.reason, self.tripped = other.state, other.reason, other.tripped
        for name, suspicion in self._suspicions.items():
            suspicion.seconds = other._suspicions[name].seconds

    def judge(self, evidence: Mapping[str, float], elapsed: float) -> LoopState:
        """Take in evidence of the last ``elapsed`` [s], as multiples of the thresholds; return the level now."""
        most, name = 0.0, ""
        for key, r in evidence.items():
            if (seconds := self._suspicions[key].add(r, elapsed)) > most:
                most, name = seconds, key
        before, level = self.state, LoopState.DRIVING
        for state, after in zip(self.tripped, self.ladder, strict=True):
            if most >= (AGAIN * after if state <= before else after):
                level = state
        if level > before:
            self.tripped[level] += 1
            self.reason = name
        elif level == LoopState.DRIVING:
            self.reason = ""
        self.state = level
        return level
