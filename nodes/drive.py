"""Drive: the commands that drive the plant, each in force from the moment it came, and how they answer measurements."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hybrid_sysid_ros.nodes.timing import Timing

NEVER = -math.inf
REMEMBERED = 1024  # measurements whose time of publishing is known


class Drive:
    """Holds the last command, and zero when none has come for `timeout` [s]. Times [s] are on one clock.

    saturated: commands beyond the limit, bounded. timeouts: times that the input was zeroed because commands stopped.
    """

    def __init__(self, *, limit: float, timeout: float) -> None:
        self.limit = limit
        self.timeout = timeout
        self.saturated = 0
        self.timeouts = 0
        self._pending: deque[tuple[float, float]] = deque()
        self._value = 0.0
        self._last = NEVER

    def command(self, value: float, time: float) -> None:
        """A finite value that is in force from `time` on; times must not fall."""
        self.saturated += abs(value) > self.limit
        self._pending.append((time, min(max(value, -self.limit), self.limit)))

    def at(self, time: float) -> float:
        """Input at a time; times must not fall."""
        while self._pending and self._pending[0][0] <= time:
            self._last, self._value = self._pending.popleft()
        if time - self._last > self.timeout and self._last > NEVER:
            self.timeouts += 1
            self._last, self._value = NEVER, 0.0
        return self._value


class Answers:
    """Which measurement was answered by which command, and how long that took.

    Measurement k has the stamp start + k period [ns]. missed: measurements without a command before the next one,
    counted from the first command on; last_missed: the last of them, or -1.
    """

    def __init__(self, *, start: int, period: int) -> None:
        self.start = start
        self.period = period
        self.latest = -1
        self.answered = -1
        self.commands = 0
        self.missed = 0
        self.last_missed = -1
        self.delay = Timing()
        self._published = np.zeros(REMEMBERED)

    def stamp(self, number: int) -> int:
        """Stamp of a measurement [ns]."""
        return self.start + number * self.period

    def measured(self, number: int, time: float) -> None:
        """Measurement `number` was taken at `time` [s]."""
        if self.commands and self.answered < self.latest:
            self.missed += 1
            self.last_missed = self.latest
        self._published[number % REMEMBERED] = time
        self.latest = number

    def answer(self, stamp: int, time: float) -> bool:
        """A command came at `time` [s]: whether it answers a measurement that no earlier command was newer than."""
        number, rest = divmod(stamp - self.start, self.period)
        if rest or not self.answered < number <= self.latest or number <= self.latest - REMEMBERED:
            return False
        self.commands += 1
        self.answered = number
        self.delay.add(time - float(self._published[number % REMEMBERED]))
        return True
