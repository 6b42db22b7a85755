"""Reading: a bag into a record."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.columns import Columns, MissingInMessageError
from hybrid_sysid_ros.bags.contents import Contents, contents
from hybrid_sysid_ros.bags.sampling import FEWEST, SamplingError, last_before, mean_held, uniform_period
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.files import sha256
from hybrid_sysid_ros.record import Record
from hybrid_sysid_ros.signals import Signal, Signals

logger = logging.getLogger(__name__)


def read(path: Path | str, signals: Signals, *, recover: bool = False) -> Record:
    """Read a record out of a bag: a rosbag2 folder, or one MCAP or SQLite file. ROS need not be installed.

    Time is that of the output's topic (header stamps, or time of logging without a header) on the uniform grid. An
    input from the same topic is taken sample by sample; from another topic it is held between its messages and
    averaged over each interval, and samples for which it is not known are cut off. Channels of other topics are held,
    NaN before their first message; channels that the bag has not got are left out.

    recover: read the part before the damage of a cut MCAP file; how much it is goes to the log.

    Raises:
        UserError: bag, topic, field, number or stamp is missing or wrong; see the message.
    """
    path = Path(path)
    wanted = {signals.topic(signal) for signal in (*signals.input, *signals.output, *signals.channels.values())}
    return _Reading(path, signals, contents(path, wanted, recover=recover)).record()


class _Reading:
    """One bag on its way into a record."""

    def __init__(self, path: Path, signals: Signals, found: Contents) -> None:
        self.path = path
        self.signals = signals
        self.contents = found
        self.topics: dict[str, Columns] = {}

    def record(self) -> Record:
        first = self.signals.output[0]
        stamps = self.stamps(first)
        try:
            period = uniform_period(stamps, expected=self.signals.period)
        except SamplingError as error:
            raise UserError(f"{self.at(first)}: {error}") from error
        known = slice(0, len(stamps))
        for signal in self.signals.input:
            known = _common(known, self.known_samples(signal, stamps, period))
        if known.stop - known.start < FEWEST:
            names = ", ".join(self.signals.topic(signal) for signal in self.signals.input)
            raise UserError(
                f"{self.path}: {names} has no message while {self.signals.topic(first)} has: nothing to read"
            )
        if known.stop - known.start < len(stamps):
            logger.info("%s: samples %d to %d have a known input", self.path, known.start, known.stop - 1)
        outputs = [self.finite(signal, self.values(signal), stamps)[known] for signal in self.signals.output]
        inputs = [self.input(signal, stamps, period, known) for signal in self.signals.input]
        resolved = self.path.resolve()
        return Record(
            name=resolved.name if resolved.is_dir() else resolved.stem,
            time=np.arange(known.stop - known.start) * np.float64(period),
            input=np.column_stack(inputs),
            output=np.column_stack(outputs),
            channels={
                key: self.channel(signal, stamps)[known]
                for key, signal in self.signals.channels.items()
                if self.has(signal)
            },
            source=str(self.path),
            digest=sha256(self.path),
        )

    def columns(self, signal: Signal) -> Columns:
        """Messages of a signal's topic."""
        name = self.signals.topic(signal)
        if name not in self.contents.topics:
            where = f" in {self.signals.source}" if self.signals.source else ""
            raise UserError(
                f"{self.path}: no topic {name}: the bag has {self.contents.listing}; "
                f"name the right one{where} (--signals)"
            )
        if not self.contents.messages[name].data:
            raise UserError(f"{self.path}: topic {name} has no messages: was its publisher running?")
        if name not in self.topics:
            self.topics[name] = Columns(self.contents.messages[name], self.contents.typestore)
        return self.topics[name]

    def values(self, signal: Signal) -> NDArray[np.float64]:
        """A signal's values, (messages,), scaled."""
        try:
            return signal.scale * self.columns(signal).values(signal.field) + signal.offset
        except MissingInMessageError as error:
            raise UserError(f"{self.at(signal)}: field {signal.field} is missing in {error}") from error

    def stamps(self, signal: Signal) -> NDArray[np.int64]:
        """A signal's times, (messages,) [ns]."""
        self.values(signal)  # the field is there in every message
        return self.columns(signal).stamps(signal.field)

    def shares_topic(self, signal: Signal) -> bool:
        """Whether a signal comes in the messages of the output."""
        return self.signals.topic(signal) == self.signals.topic(self.signals.output[0])

    def known_samples(self, signal: Signal, stamps: NDArray[np.int64], period: float) -> slice:
        """Samples whose input is known: from the first to the last message of the input, and one interval on."""
        if self.shares_topic(signal):
            return slice(0, len(stamps))
        own = self.stamps(signal)
        step = int(np.median(np.diff(own))) if len(own) > 1 else 0
        margin = int(0.5e9 * period)
        last = own[-1] + (step if signal.holds == "following" else 0)
        first = own[0] - (step if signal.holds == "preceding" else 0)
        start = int(np.searchsorted(stamps, first - margin, side="right"))
        return slice(start, int(np.searchsorted(stamps, last + margin, side="left")))

    def input(self, signal: Signal, stamps: NDArray[np.int64], period: float, known: slice) -> NDArray[np.float64]:
        """Mean input over the interval that begins at each known sample."""
        values = self.values(signal)
        if self.shares_topic(signal):
            preceding = signal.holds == "preceding"
            values = self.finite(signal, values, stamps, unused=int(preceding))
            return (np.append(values[1:], values[-1]) if preceding else values)[known]
        own = self.stamps(signal)
        order = np.diff(own)
        if (order <= 0).any():
            k = int(np.argmax(order <= 0)) + 1
            kind = "repeated" if order[k - 1] == 0 else "reversed"
            raise UserError(f"{self.at(signal)}: {kind} stamp at message {k} ({(own[k] - own[0]) * 1e-9:.6g} s)")
        values = self.finite(signal, values, own)
        seconds = _on_grid(own, stamps, period)
        if signal.holds == "preceding" and len(own) > 1:  # value j is held from the stamp of value j - 1
            seconds = np.append(2 * seconds[0] - seconds[1], seconds[:-1])
        edges = period * np.arange(known.start, known.stop + 1)
        seconds[0] = min(seconds[0], edges[0])
        return mean_held(seconds, values, edges)

    def has(self, signal: Signal) -> bool:
        """Whether the bag has a channel."""
        name = self.signals.topic(signal)
        if name not in self.contents.topics or not self.contents.messages[name].data:
            return False
        try:
            self.columns(signal).values(signal.field)
        except MissingInMessageError as error:
            logger.debug("%s: channel left out, %s", self.at(signal), error)
            return False
        return True

    def channel(self, signal: Signal, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        """A channel's most recent value at each sample."""
        if self.shares_topic(signal):
            return self.values(signal)
        return last_before(self.stamps(signal), self.values(signal), stamps)

    def finite(
        self, signal: Signal, values: NDArray[np.float64], stamps: NDArray[np.int64], *, unused: int = 0
    ) -> NDArray[np.float64]:
        """Return the values if all are finite, but for the first `unused` ones."""
        wrong = ~np.isfinite(values)
        wrong[:unused] = False
        if wrong.any():
            k = int(np.argmax(wrong))
            seconds = (stamps[k] - stamps[0]) * 1e-9
            raise UserError(
                f"{self.at(signal)}: {signal.field} is {values[k]:g} at sample {k} ({seconds:.6g} s), "
                f"{int(wrong.sum())} such in all: cut the bag or repair the driver"
            )
        return values

    def at(self, signal: Signal) -> str:
        """Bag and topic, for messages to the user."""
        return f"{self.path}: topic {self.signals.topic(signal)}"


def _on_grid(own: NDArray[np.int64], stamps: NDArray[np.int64], period: float) -> NDArray[np.float64]:
    """Times [s] of another topic on the record's grid: what has a sample's stamp has its time, whatever its jitter."""
    since = (own - stamps[0]) * 1e-9
    raw = (stamps - stamps[0]) * 1e-9
    grid = period * np.arange(len(stamps))
    inside = np.interp(since, raw, grid)
    return np.asarray(inside + np.minimum(since, 0.0) + np.maximum(since - raw[-1], 0.0))


def _common(first: slice, second: slice) -> slice:
    start = max(first.start, second.start)
    return slice(start, max(start, min(first.stop, second.stop)))
