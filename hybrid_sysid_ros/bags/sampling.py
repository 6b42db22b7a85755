"""Sampling: the samples of a record, and signals resampled at them, block by block."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.gaps import MOST_MISSING, FilledBlock, SamplingError, missing_before

JITTER = 0.2  # largest distance of a stamp from the uniform grid, in sampling times
PERIOD_TOLERANCE = 0.02  # relative deviation from the expected sampling time
FEWEST = 3  # samples of a record


def uniform_period(stamps: NDArray[np.int64], *, expected: float | None = None) -> float:
    """Sampling time [s] of stamps (samples,) [ns] that lie on a uniform grid but for a little jitter.

    Raises SamplingError for too few samples, reversed, repeated or irregular stamps, and another sampling time.
    """
    median = median_step(stamps)
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


def median_step(stamps: NDArray[np.int64]) -> float:
    """Median of the steps of stamps (samples,) [ns], in s.

    Raises SamplingError for too few samples, and for reversed or repeated stamps.
    """
    if len(stamps) < FEWEST:
        raise SamplingError(f"only {len(stamps)} samples: a record needs {FEWEST} or more")
    check_order(stamps)
    return float(np.median(np.diff(stamps))) * 1e-9


def check_order(stamps: NDArray[np.int64], *, what: str = "sample", number: int = 0, origin: int | None = None) -> None:
    """Check that stamps (samples,) [ns] rise.

    The message uses what the stamps belong to (what), the number of the first, and the stamp of time 0 (origin) [ns].

    Raises SamplingError where a stamp is reversed or repeated.
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


def multiple(period: float, sampling_time: float) -> int:
    """Number of samples in a period [s]. Raises SamplingError where the period is no multiple of the sampling time."""
    count = max(1, round(period / sampling_time))
    if not abs(count * sampling_time - period) <= PERIOD_TOLERANCE * period:
        raise SamplingError(
            f"sampling time is {sampling_time:.6g} s, and period {period:g} s no multiple of it: "
            f"the nearest is {count * sampling_time:.6g} s"
        )
    return count


class RecordSamples:
    """The samples of a record, from stamps that come in blocks: every n-th stamp, where the record is slower.

    expected: sampling time of the stamps [s], None for any. period: sampling time of the record, None for that of the
    stamps. every: n. step: sampling time of the stamps in the first block [s]. gaps: lengths of the gaps in samples.
    """

    def __init__(self, *, expected: float | None, period: float | None) -> None:
        self.every = 1
        self.gaps: list[int] = []
        self._expected = expected
        self._period = period
        self._kept: list[NDArray[np.int64]] = []
        self._measured: list[NDArray[np.bool_]] = []
        self._taken = self._messages = self._origin = self._last = 0
        self.step = 0.0

    def add(self, stamps: NDArray[np.int64]) -> FilledBlock:
        """Take the next stamps (messages,) [ns]; return their places among the samples.

        Raises SamplingError where the sampling is not uniform, or the period is no multiple of the sampling time.
        """
        begins, step = not self._taken, self.step
        if begins:
            self._origin, step, joined = int(stamps[0]), median_step(stamps), stamps
        else:
            joined = np.append(self._last, stamps)
            check_order(joined, number=self._messages - 1, origin=self._origin)
        missing = missing_before(joined, step, number=max(self._messages - 1, 0), origin=self._origin)
        block = FilledBlock(np.append(0, missing) if begins else missing)
        since = block.filled(np.float64(stamps - self._origin), float(self._last - self._origin), "line")
        samples = self._origin + np.round(since).astype(np.int64)
        if begins:
            self.step = uniform_period(samples, expected=self._expected)
            self.every = 1 if self._period is None else multiple(self._period, self.step)
        chosen = slice(-self._taken % self.every, None, self.every)
        self._kept.append(samples[chosen].copy())  # a view would keep all of them
        self._measured.append(block.measured[chosen].copy())
        self.gaps += missing[missing > 0].tolist()
        self._taken += len(samples)
        self._messages += len(stamps)
        self._last = int(stamps[-1])
        return block

    def missing(self) -> str:
        """How many samples are missing, in a line; "" where none are.

        Raises SamplingError where more than a share MOST_MISSING is missing.
        """
        if not self.gaps:
            return ""
        lost, gaps = sum(self.gaps), len(self.gaps)
        words = f"{lost} of {self._taken} samples are missing, in {gaps} gap{'s' * (gaps > 1)}"
        if lost > MOST_MISSING * self._taken:
            raise SamplingError(f"{words}: the driver or the recorder could not keep up: record it again")
        return f"{words} of up to {max(self.gaps)}: filled in, and left out by fits and scores"

    @cached_property
    def measured(self) -> NDArray[np.bool_] | None:
        """Which samples were measured, (samples,); None for all."""
        return np.concatenate(self._measured) if self.gaps else None

    @cached_property
    def stamps(self) -> NDArray[np.int64]:
        """All samples, (samples,) [ns]."""
        stamps = np.concatenate(self._kept) if self._kept else np.empty(0, dtype=np.int64)
        self._kept.clear()
        return stamps

    @cached_property
    def period(self) -> float:
        """Sampling time [s]. Raises SamplingError for too few samples, and for samples that are not uniform."""
        return uniform_period(self.stamps, expected=self._expected if self.every == 1 else None)


def _rounded(period: float, samples: int) -> float:
    """The period in whole nanoseconds, where this moves the last sample by at most a tenth of the jitter."""
    nearest = round(period, 9)
    return nearest if abs(nearest - period) * samples < 0.1 * JITTER * period else period


class Resampled(ABC):
    """A signal that is resampled at the samples of a record. It keeps one number for each sample."""

    @abstractmethod
    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take the next messages: stamps [ns] and values, both (messages,)."""

    @abstractmethod
    def result(self) -> NDArray[np.float64]:
        """Values at the samples, (samples,), after all messages were taken."""


class EveryNth(Resampled):
    """The first of every `size` values, for a signal in the messages that define the samples."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._taken = 0
        self._kept: list[NDArray[np.float64]] = []

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        self._kept.append(values[-self._taken % self._size :: self._size].copy())  # a view would keep all of them
        self._taken += len(values)

    def result(self) -> NDArray[np.float64]:
        return np.concatenate(self._kept)


class GroupMean(Resampled):
    """Mean of every `size` values, for an input in the messages that define the samples.

    skip: 1 where values belong to the interval before their message: then the first one is not used, and the last
        sample repeats the value before it where no message follows.
    """

    def __init__(self, size: int, *, skip: int) -> None:
        self._size = size
        self._skip = self._to_skip = skip
        self._means: list[NDArray[np.float64]] = []
        self._rest = np.empty(0)
        self._last = np.empty(0)

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        used = values[self._to_skip :]
        self._to_skip = max(0, self._to_skip - len(values))
        used = np.concatenate([self._rest, used])
        whole = len(used) // self._size * self._size
        self._means.append(used[:whole].reshape(-1, self._size).mean(axis=1))
        self._rest = used[whole:].copy()
        self._last = values[-1:].copy()

    def result(self) -> NDArray[np.float64]:
        last = self._rest.mean(keepdims=True) if len(self._rest) else self._last[: self._skip]
        return np.concatenate([*self._means, last])


class Held(Resampled):
    """A signal of another topic, which is held from each message to the next."""

    def __init__(self) -> None:
        self._stamp = np.empty(0, dtype=np.int64)
        self._value = np.empty(0)

    def _hold(self, begins: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Hold values[j] from begins[j] [ns] on, and the previous value until begins[0]."""
        begins, values = np.append(self._stamp, begins), np.append(self._value, values)
        self._take(begins, values)
        self._stamp, self._value = begins[-1:], values[-1:]

    def _hold_until(self, stop: int) -> None:
        """Hold the last value until `stop` [ns]."""
        if len(self._stamp) and self._stamp[0] < stop:
            self._hold(np.array([stop]), self._value)

    @abstractmethod
    def _take(self, begins: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Resample values that are held from begins[0] to the last of begins [ns]."""


class HeldLast(Held):
    """Most recent value at each sample; NaN before the first.

    samples: (samples,) ns, rising.
    """

    def __init__(self, samples: NDArray[np.int64]) -> None:
        super().__init__()
        self._samples = samples
        self._found = np.full(len(samples), np.nan)

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        order = np.argsort(stamps, kind="stable")
        self._hold(stamps[order], values[order])

    def result(self) -> NDArray[np.float64]:
        self._hold_until(int(self._samples[-1]))
        return self._found

    def _take(self, begins: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        start = np.searchsorted(self._samples, begins[0])
        stop = np.searchsorted(self._samples, begins[-1], side="right")
        self._found[start:stop] = values[np.searchsorted(begins, self._samples[start:stop], side="right") - 1]


class HeldMean(Held):
    """Mean of an input over each interval between two edges.

    edges: (samples + 1,) ns, rising.
    preceding: values hold until their message's stamp, not from it on.
    margin: ns by which messages may lie off the edges.
    """

    def __init__(self, edges: NDArray[np.int64], *, preceding: bool, margin: int) -> None:
        super().__init__()
        self._edges = edges
        self._preceding = preceding
        self._margin = margin
        self._sums = np.zeros(len(edges) - 1)
        self._messages = self._first = self._last = self._step = 0

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take the next messages. Raises SamplingError where a stamp is repeated or reversed."""
        if self._messages:
            joined = np.append(self._last, stamps)
            check_order(joined, what="message", number=self._messages - 1, origin=self._first)
        else:
            check_order(stamps, what="message")
            steps = np.diff(stamps)
            self._first = int(stamps[0])
            self._step = int(np.median(steps)) if len(steps) else 0
            joined = np.append(stamps[0] - steps[:1].sum(), stamps)
        begins = (joined[:-1] if self._preceding else stamps).copy()
        if not self._messages:
            begins[0] -= self._margin
        self._hold(begins, values)
        self._messages += len(stamps)
        self._last = int(stamps[-1])

    def known(self) -> slice:
        """Intervals in which the input is known: from the first message to one of its steps after the last."""
        first = self._first - (self._step if self._preceding else 0) - self._margin
        last = self._last + (0 if self._preceding else self._step) + self._margin
        start = int(np.searchsorted(self._edges[:-1], first, side="right"))
        return slice(start, int(np.searchsorted(self._edges[:-1], last)))

    def result(self) -> NDArray[np.float64]:
        self._hold_until(int(self._edges[-1]))
        return np.asarray(self._sums / np.diff(self._edges))

    def _take(self, begins: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        start, stop = np.searchsorted(self._edges, (begins[0], begins[-1]))
        breaks = np.unique(np.concatenate([begins, self._edges[start:stop]]))
        interval = np.searchsorted(self._edges, breaks[:-1], side="right") - 1
        inside = (interval >= 0) & (interval < len(self._sums))
        if not inside.any():
            return
        held = values[np.searchsorted(begins, breaks[:-1][inside], side="right") - 1]
        first = interval[inside][0]
        sums = np.bincount(interval[inside] - first, weights=held * np.diff(breaks)[inside])
        self._sums[first : first + len(sums)] += sums
