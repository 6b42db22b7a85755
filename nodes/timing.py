"""Timing: steady time with the stamps of a clock that may be set, and durations counted into a histogram."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from time import monotonic_ns

import numpy as np

SET = 20_000_000
"""Error of a clock above which it was set [ns]: then stamps follow it at once."""
DRIFT = 1_000_000
"""Error of a clock below which stamps ignore it [ns], so that they are equidistant."""
SLEW = 20_000
"""Correction of stamps at each reading of a clock that drifts [ns]."""


class Timeline:
    """Steady time, with the stamps of a clock that may be set."""

    def __init__(self, clock: Callable[[], int], steady: Callable[[], int] = monotonic_ns) -> None:
        """clock: the clock of the stamps; steady: the clock of everything else; both [ns]."""
        self.sets = 0
        """Number of times that the clock was set."""
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
        """Let the stamps follow the clock; return the time since the start [ns]."""
        elapsed = self.elapsed()
        error = self._clock() - self.start - elapsed
        if abs(error) > SET:
            self.start += error
            self.sets += 1
        elif abs(error) > DRIFT:
            self.start += SLEW if error > 0 else -SLEW
        return elapsed


SHORTEST = 1e-6  # s
PER_DECADE = 200  # buckets: 1.2 % wide
DECADES = 8


class Histogram:
    """Counts durations from 1 us to 100 s. Memory is allocated once; adding one takes a quarter of a microsecond."""

    def __init__(self) -> None:
        self._counts = array("q", bytes(8 * DECADES * PER_DECADE))
        self._scale = PER_DECADE / math.log(10.0)
        self.count = 0
        self.longest = 0.0

    def add(self, duration: float) -> None:
        """Count a duration [s]."""
        bucket = int(self._scale * math.log(duration / SHORTEST)) if duration > SHORTEST else 0
        self._counts[min(bucket, len(self._counts) - 1)] += 1
        self.count += 1
        if duration > self.longest:
            self.longest = duration

    def percentile(self, percent: float) -> float:
        """Duration [s] that `percent` of all don't exceed, to the bucket's upper end; NaN without any."""
        if not self.count:
            return math.nan
        counts = np.frombuffer(self._counts, dtype=np.int64).cumsum()
        bucket = int(np.searchsorted(counts, percent / 100.0 * self.count))
        return min(SHORTEST * math.exp((bucket + 1) / self._scale), self.longest)


class Timing:
    """Durations of the window since the last report and of the whole run."""

    def __init__(self) -> None:
        self.window = Histogram()
        self.total = Histogram()

    def add(self, duration: float) -> None:
        """Count a duration [s]."""
        self.window.add(duration)
        self.total.add(duration)

    def report(self, name: str) -> dict[str, float]:
        """Milliseconds by key: p50, p99 and max of the whole run and of the window, which is then reset."""
        found = {}
        for part, histogram in (("", self.total), ("_window", self.window)):
            found[f"{name}_ms{part}_p50"] = 1e3 * histogram.percentile(50)
            found[f"{name}_ms{part}_p99"] = 1e3 * histogram.percentile(99)
            found[f"{name}_ms{part}_max"] = 1e3 * histogram.longest if histogram.count else math.nan
        self.window = Histogram()
        return found
