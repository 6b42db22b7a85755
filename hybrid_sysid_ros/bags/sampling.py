"""Sampling: stamps of messages put on a uniform grid, and every n-th of them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

JITTER = 0.2  # largest distance of a stamp from the uniform grid, in sampling times
GAP = 1.5  # an interval longer than this many sampling times is a gap
PERIOD_TOLERANCE = 0.02  # relative deviation from the expected sampling time
FEWEST = 3  # samples of a record


class SamplingError(ValueError):
    """The stamps are not those of a uniform sampling; the text says where and what to do."""


def uniform_period(stamps: NDArray[np.int64], *, expected: float | None = None) -> float:
    """Sampling time [s] of stamps (samples,) [ns] that lie on a uniform grid but for a little jitter.

    Raises:
        SamplingError: too few samples, reversed or repeated stamps, a gap, irregular sampling, or not the expected one.
    """
    if len(stamps) < FEWEST:
        raise SamplingError(f"only {len(stamps)} samples: a record needs {FEWEST} or more")
    check_order(stamps)
    median = float(np.median(np.diff(stamps))) * 1e-9
    check_gaps(stamps, median)
    seconds = (stamps - stamps[0]) * 1e-9
    number = np.arange(len(seconds)) - 0.5 * (len(seconds) - 1)
    period = float(number @ seconds / (number @ number))
    distance = np.abs(seconds - seconds.mean() - period * number)
    if (distance > JITTER * median).any():
        k = int(np.argmax(distance))
        raise SamplingError(
            f"sampling is not uniform: sample {k} ({seconds[k]:.6g} s) is {distance[k]:.3g} s off a grid of "
            f"{period:.6g} s: let the driver stamp messages when it samples"
        )
    if expected is not None and abs(period - expected) > PERIOD_TOLERANCE * expected:
        raise SamplingError(f"sampling time is {period:.6g} s where {expected:.6g} s is expected: check signals.period")
    return _rounded(period, len(stamps))


def check_order(stamps: NDArray[np.int64], *, what: str = "sample", number: int = 0, origin: int | None = None) -> None:
    """Check that stamps (samples,) [ns] rise.

    what, number, origin: for the message: what the stamps are of, number of the first, and when time is 0 [ns].

    Raises:
        SamplingError: a stamp is reversed or repeated.
    """
    steps = np.diff(stamps)
    if (steps > 0).all():
        return
    k = int(np.argmax(steps <= 0)) + 1
    seconds = (stamps - (stamps[0] if origin is None else origin)) * 1e-9
    if steps[k - 1] == 0:
        raise SamplingError(
            f"repeated stamp at {what} {number + k} ({seconds[k]:.6g} s): "
            f"two publishers on the topic, or a driver that stamps twice: record it with one"
        )
    raise SamplingError(
        f"reversed stamp at {what} {number + k}: {seconds[k]:.6g} s after {seconds[k - 1]:.6g} s: "
        f"the clock was set back, or messages were recorded out of order: cut the bag there"
    )


def check_gaps(stamps: NDArray[np.int64], period: float, *, number: int = 0, origin: int | None = None) -> None:
    """Check that rising stamps (samples,) [ns] with a sampling time of `period` [s] leave none out.

    number, origin: see check_order().

    Raises:
        SamplingError: there is a gap.
    """
    steps = np.diff(stamps) * 1e-9
    if (steps <= GAP * period).all():
        return
    k = int(np.argmax(steps > GAP * period))
    seconds = (stamps[k] - (stamps[0] if origin is None else origin)) * 1e-9
    raise SamplingError(
        f"gap of {steps[k]:.6g} s after sample {number + k} ({seconds:.6g} s), about {round(steps[k] / period) - 1} "
        f"samples missing: cut the bag there or record it again"
    )


def multiple(period: float, sampling_time: float) -> int:
    """How many samples make a period [s].

    Raises:
        SamplingError: the period is no multiple of the sampling time.
    """
    count = max(1, round(period / sampling_time))
    if not abs(count * sampling_time - period) <= PERIOD_TOLERANCE * period:
        raise SamplingError(
            f"sampling time is {sampling_time:.6g} s, and period {period:g} s no multiple of it: "
            f"the nearest is {count * sampling_time:.6g} s"
        )
    return count


class Samples:
    """The samples of a record, from stamps that come in blocks: every n-th, where the record is to be slower.

    expected: sampling time of the stamps [s], None for any; period: of the record, None for that of the stamps.
    every: n. step: sampling time of the stamps, as the first block of them shows it [s].
    """

    def __init__(self, *, expected: float | None, period: float | None) -> None:
        self.every = 1
        self._expected = expected
        self._period = period
        self._kept: list[NDArray[np.int64]] = []
        self._taken = self._origin = self._last = 0
        self.step = 0.0

    def add(self, stamps: NDArray[np.int64]) -> None:
        """Take the stamps that follow, (messages,) [ns].

        Raises:
            SamplingError: they are not those of a uniform sampling, or the period is no multiple of it.
        """
        if self._taken:
            joined, number = np.append(self._last, stamps), self._taken - 1
            check_order(joined, number=number, origin=self._origin)
            check_gaps(joined, self.step, number=number, origin=self._origin)
        else:
            self._origin = int(stamps[0])
            self.step = uniform_period(stamps, expected=self._expected)
            self.every = 1 if self._period is None else multiple(self._period, self.step)
        self._kept.append(stamps[-self._taken % self.every :: self.every].copy())  # a view would keep all of them
        self._taken += len(stamps)
        self._last = int(stamps[-1])

    @cached_property
    def stamps(self) -> NDArray[np.int64]:
        """All samples, (samples,) [ns]."""
        stamps = np.concatenate(self._kept) if self._kept else np.empty(0, dtype=np.int64)
        self._kept.clear()
        return stamps

    @cached_property
    def period(self) -> float:
        """Sampling time [s].

        Raises:
            SamplingError: too few samples, or they are not uniform.
        """
        return uniform_period(self.stamps, expected=self._expected if self.every == 1 else None)


def _rounded(period: float, samples: int) -> float:
    """Whole nanoseconds, where that does not move the last sample by more than a tenth of the jitter."""
    nearest = round(period, 9)
    return nearest if abs(nearest - period) * samples < 0.1 * JITTER * period else period
