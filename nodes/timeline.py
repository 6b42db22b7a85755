"""Timeline: steady time since a start, and its stamps in the ROS clock, which may be set or drift."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns

SET = 20_000_000
"""A clock that is off by more was set [ns]: stamps follow it at once."""
DRIFT = 1_000_000
"""A clock that is off by less is right [ns], so that stamps are equally far apart."""
SLEW = 20_000
"""By how much stamps follow a clock that drifts, at each look [ns]."""


class Timeline:
    """Time that no clock can set, with the stamps of a clock that somebody can."""

    def __init__(self, clock: Callable[[], int], steady: Callable[[], int] = monotonic_ns) -> None:
        """clock: that of the stamps; steady: of everything else; both [ns]."""
        self.sets = 0
        """How often the clock was set."""
        self._clock, self._steady = clock, steady
        self.begin(clock())

    def begin(self, stamp: int) -> None:
        """Let time 0 be the one of a stamp [ns]."""
        self.start = stamp
        """Stamp of time 0 [ns]."""
        self._zero = self._steady() - (self._clock() - stamp)

    def elapsed(self) -> int:
        """Steady time since the start [ns]."""
        return self._steady() - self._zero

    def follow(self) -> int:
        """Let the stamps follow the clock; returns the time since the start [ns]."""
        elapsed = self.elapsed()
        error = self._clock() - self.start - elapsed
        if abs(error) > SET:
            self.start += error
            self.sets += 1
        elif abs(error) > DRIFT:
            self.start += SLEW if error > 0 else -SLEW
        return elapsed
