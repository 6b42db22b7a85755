"""Reading: a bag becomes a record, block by block."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags import sampling
from hybrid_sysid_ros.bags.bag import Bag, name_of, opened
from hybrid_sysid_ros.bags.columns import MissingInMessageError, TopicColumns
from hybrid_sysid_ros.bags.gaps import FilledBlock, Filler, SamplingError
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.bags.signals import Signal, Signals
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256

logger = logging.getLogger(__name__)

LONGEST_PERIOD = 1e6
"""Longest sampling time of a record [s]."""

Key = tuple[str, int | str]  # input or output and its number, channel and its name


def read(path: Path | str, signals: Signals, *, period: float | None = None, recover: bool = False) -> Record:
    """Read a record from a bag: a rosbag2 folder, or one MCAP or SQLite file. ROS need not be installed.

    Time comes from the output's topic (header stamps, or times of logging without a header), on a uniform grid. An
    input of the same topic is read sample by sample; one of another topic is held between its messages and averaged
    over each interval, and samples at which it is unknown are cut off. Channels of other topics are held, and NaN
    before their first message; channels that the bag lacks are left out. Short gaps are filled in: outputs by a
    straight line, inputs by holding, channels by NaN; the record marks the measured samples, and a log line says so.

    The bag is read in blocks, in one pass, or in two where signals come from other topics than the output's. Only the
    record's arrays grow with its length.

    period: sampling time [s] of the record, a multiple of the bag's: every n-th output, with the input averaged between
        them. It is meant for bags whose arrays would not fit into memory.
    recover: read the part of a cut MCAP file before the damage; its length is logged.

    Raises UserError where bag, topic, field, number, stamp or period is missing or wrong.
    """
    if period is not None and not 0 < period <= LONGEST_PERIOD:
        raise UserError(f"period is {period:g}: it needs seconds above 0 and at most {LONGEST_PERIOD:g}")
    with opened(path, recover=recover) as bag:
        return _BagReader(bag, signals, period).record()


class _BagReader:
    """The reading of one bag into a record."""

    def __init__(self, bag: Bag, signals: Signals, period: float | None) -> None:
        self.bag = bag
        self.signals = signals
        self.samples = sampling.RecordSamples(expected=signals.period, period=period)
        self.wanted: dict[Key, Signal] = {
            **{("output", number): signal for number, signal in enumerate(signals.output)},
            **{("input", number): signal for number, signal in enumerate(signals.input)},
            **{("channel", name): signal for name, signal in signals.channels.items()},
        }
        self.found: dict[Key, sampling.Resampled] = {}
        self.stamped: dict[str, bool] = {}  # by topic: whether headers have stamps
        self.origins: dict[str, int] = {}  # by topic: the first stamp [ns]
        self.block: FilledBlock | None = None  # samples of the output's messages
        self.last: dict[Key, float] = {}  # newest value of its signals

    def record(self) -> Record:
        for signal in (*self.signals.output, *self.signals.input):
            self.check_topic(signal)
        first = self.signals.output[0]
        topic = self.signals.topic(first)
        for columns in self.columns({topic}):
            with self.clear(first):
                self.block = self.samples.add(self.stamps(columns, first))
            self.add(columns)
        self.block = None
        with self.clear(first):
            period, missing = self.samples.period, self.samples.missing()
        if missing:
            logger.warning("%s: %s", self.at(first), missing)
        for columns in self.columns({self.signals.topic(signal) for signal in self.wanted.values()} - {topic}):
            self.add(columns)
        for number, signal in enumerate(self.signals.input):
            if ("input", number) not in self.found:
                raise self.silent(signal)
        known = self.known()
        return Record(
            name=name_of(self.bag.path),
            time=np.arange(known.stop - known.start) * np.float64(period),
            input=np.column_stack([self.taken("input", k)[known] for k in range(len(self.signals.input))]),
            output=np.column_stack([self.taken("output", k)[known] for k in range(len(self.signals.output))]),
            channels={
                name: self.taken("channel", name)[known]
                for name in self.signals.channels
                if ("channel", name) in self.found
            },
            measured=None if self.samples.measured is None else self.samples.measured[known],
            source=str(self.bag.path),
            digest=sha256(self.bag.path),
        )

    def columns(self, topics: Collection[str]) -> Iterator[TopicColumns]:
        """Messages of those topics that the bag has, block by block."""
        for block in self.bag.blocks([name for name in topics if name in self.bag.topics]):
            yield TopicColumns(block, stamped=self.stamped.get(block.topic))

    def add(self, columns: TopicColumns) -> None:
        """Take the signals of a block."""
        topic = columns.messages.topic
        for key, signal in list(self.wanted.items()):
            if self.signals.topic(signal) != topic:
                continue
            try:
                stamps, values = self.stamps(columns, signal), self.values(columns, signal)
            except MissingInMessageError as error:
                if key[0] != "channel":
                    raise self.missing(signal, error) from error
                logger.debug("%s: channel left out, %s", self.at(signal), error)
                del self.wanted[key]
                self.found.pop(key, None)
                continue
            if key not in self.found:
                self.found[key] = self.resampled(key, signal)
            if key[0] != "channel":
                self.check_finite(columns, signal, values, input=key[0] == "input")
            if self.block is not None:
                before, self.last[key] = self.last.get(key, np.nan), float(values[-1])
                values = self.block.filled(values, before, self.filler(key, signal))
            with self.clear(signal):
                self.found[key].add(stamps, values)

    def filler(self, key: Key, signal: Signal) -> Filler:
        """How the gaps of a signal are filled."""
        if key[0] == "output":
            return "line"
        return "unknown" if key[0] == "channel" else "preceding" if signal.holds == "preceding" else "following"

    def resampled(self, key: Key, signal: Signal) -> sampling.Resampled:
        """How a signal is resampled."""
        preceding = signal.holds == "preceding"
        if key[0] != "input":
            return (
                sampling.EveryNth(self.samples.every)
                if self.shares_topic(signal)
                else sampling.HeldLast(self.samples.stamps)
            )
        if self.shares_topic(signal):
            return sampling.GroupMean(self.samples.every, skip=int(preceding))
        edges = np.append(self.samples.stamps, self.samples.stamps[-1] + round(1e9 * self.samples.period))
        return sampling.HeldMean(edges, preceding=preceding, margin=int(0.5e9 * self.samples.step))

    def taken(self, kind: str, name: int | str) -> NDArray[np.float64]:
        """A signal's values at the samples; they can be taken once."""
        return self.found.pop((kind, name)).result()

    def known(self) -> slice:
        """Samples at which all inputs are known."""
        start, stop = 0, len(self.samples.stamps)
        for held in self.found.values():
            if isinstance(held, sampling.HeldMean):
                start, stop = max(start, held.known().start), min(stop, held.known().stop)
        if stop - start < sampling.FEWEST:
            names = ", ".join(self.signals.topic(signal) for signal in self.signals.input)
            first = self.signals.topic(self.signals.output[0])
            raise UserError(f"{self.bag.path}: {names} has no message while {first} has: nothing to read")
        if stop - start < len(self.samples.stamps):
            logger.info("%s: samples %d to %d have a known input", self.bag.path, start, stop - 1)
        return slice(start, stop)

    def values(self, columns: TopicColumns, signal: Signal) -> NDArray[np.float64]:
        """A signal's scaled values, (messages,)."""
        return signal.scale * columns.values(signal.field) + signal.offset

    def stamps(self, columns: TopicColumns, signal: Signal) -> NDArray[np.int64]:
        """A signal's times, (messages,) [ns]."""
        columns.values(signal.field)  # the field is there in every message
        stamps = columns.stamps(signal.field)
        self.stamped.setdefault(columns.messages.topic, columns.stamped)
        self.origins.setdefault(columns.messages.topic, int(stamps[0]))
        return stamps

    def shares_topic(self, signal: Signal) -> bool:
        """Whether a signal comes in the messages of the output."""
        return self.signals.topic(signal) == self.signals.topic(self.signals.output[0])

    def check_topic(self, signal: Signal) -> None:
        """Raise UserError where the topic of an input or output is missing."""
        name = self.signals.topic(signal)
        if name not in self.bag.topics:
            raise UserError(f"{self.bag.path}: no topic {name}: the bag has {self.bag.listing}; {self.right_one}")
        if not self.bag.topics[name].messages:
            raise self.silent(signal)

    def silent(self, signal: Signal) -> UserError:
        """The error for a topic without messages."""
        return UserError(f"{self.at(signal)} has no messages: was its publisher running?")

    def check_finite(self, columns: TopicColumns, signal: Signal, values: NDArray[np.float64], *, input: bool) -> None:
        """Raise UserError for a value that is not finite, except for an input before the first sample."""
        wrong, first = ~np.isfinite(values), columns.messages.first
        if input and not first and self.shares_topic(signal) and signal.holds == "preceding":
            wrong[0] = False
        if wrong.any():
            k = int(np.argmax(wrong))
            seconds = (self.stamps(columns, signal)[k] - self.origins[columns.messages.topic]) * 1e-9
            raise UserError(
                f"{self.at(signal)}: {signal.field} is {values[k]:g} at sample {first + k} ({seconds:.6g} s), "
                f"{int(wrong.sum())} such up to sample {first + len(values) - 1}: cut the bag or repair the driver"
            )

    @contextmanager
    def clear(self, signal: Signal) -> Iterator[None]:
        """Add bag and topic to errors of sampling and of missing fields."""
        try:
            yield
        except SamplingError as error:
            raise UserError(f"{self.at(signal)}: {error}") from error
        except MissingInMessageError as error:
            raise self.missing(signal, error) from error

    def missing(self, signal: Signal, error: MissingInMessageError) -> UserError:
        """The error for a topic whose messages lack a field."""
        return UserError(f"{self.at(signal)}: field {signal.field} is missing in {error}; {self.right_one}")

    @property
    def right_one(self) -> str:
        """Advice for a bag with other topics or fields than the signals name."""
        where = f" in {self.signals.source}" if self.signals.source else ""
        return f"name the right one{where} (--signals), or the rig (--rig)"

    def at(self, signal: Signal) -> str:
        """Bag and topic, for messages to the user."""
        return f"{self.bag.path}: topic {self.signals.topic(signal)}"
