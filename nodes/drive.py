"""Drive: the commands that drive the plant, each from its arrival on, and the measurements that they answer."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.rigs.actuator import Actuator

NEVER = -math.inf
REMEMBERED = 1024  # measurements whose time of publishing is known


class Drive:
    """Holds the last inputs (m,), and rests when none have come for `timeout` [s]. All times [s] are of one clock."""

    def __init__(self, actuators: Sequence[Actuator], *, timeout: float) -> None:
        self.timeout = timeout
        self.saturated = 0
        """Number of commands beyond a limit, which were bounded."""
        self.timeouts = 0
        """Number of times that the inputs went to rest because commands stopped."""
        self._low = [actuator.low for actuator in actuators]
        self._high = [actuator.high for actuator in actuators]
        self._rest = [actuator.rest for actuator in actuators]
        self._pending: deque[tuple[float, list[float]]] = deque()
        self._inputs = self._rest
        self._last = NEVER

    def command(self, inputs: Sequence[float], time: float) -> None:
        """Set finite inputs (m,) from `time` on, or from the time of earlier ones, if that is later."""
        bounded = [min(max(u, low), high) for u, low, high in zip(inputs, self._low, self._high, strict=True)]
        self.saturated += bounded != list(inputs)
        earliest = self._pending[-1][0] if self._pending else time
        self._pending.append((max(time, earliest), bounded))

    def at(self, time: float) -> list[float]:
        """Inputs (m,) at a time; times must not decrease."""
        while self._pending and self._pending[0][0] <= time:
            self._last, self._inputs = self._pending.popleft()
        if time - self._last > self.timeout and self._last > NEVER:
            self.timeouts += 1
            self._last, self._inputs = NEVER, self._rest
        return self._inputs


class Answers:
    """Commands that answer measurements, and their delays.

    Measurement k has the stamp start + k period [ns]; the start may follow a clock. missed: number of measurements
    without a command before the next one, from the first command on; last_missed: the last of them, or -1.
    """

    def __init__(self, *, start: int, period: int) -> None:
        self.start = start
        self.period = period
        self.latest = -1
        self.answered = -1
        self.commands = 0
        self.missed = 0
        self.last_missed = -1
        self.last = NEVER
        """Time of the last answer [s]."""
        self.delay = Timing()
        self._published = np.zeros(REMEMBERED)
        self._stamps = np.zeros(REMEMBERED, dtype=np.int64)

    def stamp(self, number: int) -> int:
        """Stamp of a measurement [ns]."""
        return self.start + number * self.period

    def measured(self, number: int, time: float) -> None:
        """Note that measurement `number` was taken at `time` [s]."""
        if self.commands and self.answered < self.latest:
            self.missed += 1
            self.last_missed = self.latest
        self._published[number % REMEMBERED] = time
        self._stamps[number % REMEMBERED] = self.stamp(number)
        self.latest = number

    def measurement(self, stamp: int) -> int | None:
        """Number of the measurement with a stamp [ns], if it is one of the last REMEMBERED."""
        number = (stamp - self.start + self.period // 2) // self.period
        known = max(self.latest - REMEMBERED, -1) < number <= self.latest
        return number if known and self._stamps[number % REMEMBERED] == stamp else None

    def awaits(self, stamp: int) -> bool:
        """Whether a stamp belongs to a measurement that is not older than any answered one."""
        number = self.measurement(stamp)
        return number is not None and number > self.answered

    def answer(self, stamp: int, time: float) -> bool:
        """Whether a command that came at `time` [s] answers a measurement."""
        number = self.measurement(stamp)
        if number is None or number <= self.answered:
            return False
        self.commands += 1
        self.answered = number
        self.last = time
        self.delay.add(time - float(self._published[number % REMEMBERED]))
        return True
