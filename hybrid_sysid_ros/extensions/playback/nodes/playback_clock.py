"""Playback clock: which time of a bag it is, against steady time."""

from __future__ import annotations

import math
from collections.abc import Callable
from time import monotonic_ns

from hybrid_sysid_ros.nodes.messages import SECOND


class PlaybackClock:
    """Time of the bag runs `rate` times as fast as steady time, or rests."""

    def __init__(self, *, rate: float, paused: bool = False, steady: Callable[[], int] = monotonic_ns) -> None:
        """steady: time that no clock can set [ns]."""
        self.paused = paused
        self._rate, self._steady = rate, steady
        self._zero, self._from = 0, steady()  # times of the bag and of the steady clock that belong together
        self._steps = 0

    @property
    def time(self) -> int:
        """Time of the bag [ns]."""
        return self._zero if self.paused else self._zero + round(self._rate * (self._steady() - self._from))

    def go_to(self, time: int) -> None:
        """Be at a time of the bag [ns]."""
        self._zero, self._from = time, self._steady()

    def pause(self) -> None:
        """Rest, or go on."""
        self.go_to(self.time)
        self.paused = not self.paused

    def step(self) -> None:
        """Let one message pass while it rests."""
        self._steps += self.paused

    def until(self, logged: int) -> float:
        """Steady time until the next message, which was logged then [ns], is due [s]; a step makes it due now."""
        if not self.paused:
            return (logged - self.time) / (self._rate * SECOND)
        if not self._steps:
            return math.inf
        self._steps -= 1
        self.go_to(logged)
        return 0.0
