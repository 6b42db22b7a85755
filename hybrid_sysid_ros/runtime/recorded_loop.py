"""A closed loop from a bag: tracking, inputs, and the delay of each command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.bag import name_of, opened
from hybrid_sysid_ros.bags.columns import SECOND, MissingInMessageError, TopicColumns
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256

MEASUREMENT, COMMAND, REFERENCE = "joint_states", "joint_command", "reference"
MOTION = "motion"
"""Topic with the true positions of a simulated rig's joints."""
DIAGNOSTICS = "/diagnostics"
ONE_CLOCK = SECOND  # ns, largest median distance of a measurement's stamp from its logging if both are of one clock


@dataclass(frozen=True, kw_only=True)
class Delays:
    """Percentiles of delays [s]."""

    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, delays: Array) -> Delays:
        """Percentiles of delays (samples,) [s], NaN where there is none; all NaN without any."""
        known = delays[np.isfinite(delays)]
        if not len(known):
            return cls(p50=np.nan, p99=np.nan, max=np.nan)
        return cls(p50=float(np.percentile(known, 50)), p99=float(np.percentile(known, 99)), max=float(known.max()))


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRecord:
    """A recorded loop at the stamps of its measurements, with p outputs and m inputs, in SI units."""

    name: str
    rig: Rig
    stamps: NDArray[np.int64]
    """(samples,) [ns]."""
    time: Array
    """Stamps relative to the stamp of the first reference message, (samples,) [s]."""
    outputs: Array
    """Measured outputs (samples, p); the simulated rig's true ones for a sensor without any reading, where recorded."""
    reference: Array
    """References from the newest previews, linear between their points, (samples, p); NaN before the first preview, and
    for an output that is not tracked.
    """
    inputs: Array
    """Inputs applied from each stamp to the next, (samples, m)."""
    command: Array
    """Commands that answer each measurement, (samples, m); NaN where none does."""
    delay: Array
    """Time from a stamp to the logging of the command with that stamp, (samples,) [s]; NaN without a command, and
    everywhere if stamps and log use different clocks (lockstep).
    """
    turnaround: Array
    """Time from the logging of a measurement to the logging of its command, (samples,) [s]. Both are times of the
    recorder, so its own delays are included.
    """
    late: NDArray[np.bool_]
    """Whether no command had come before the next measurement (in lockstep: whether none came at all), (samples,);
    False for the last measurement, for which this is unknown.
    """
    states: tuple[tuple[float, str], ...] = ()
    """Times [s] and the controller's state as its diagnostics said it then; empty where they are not recorded."""
    source: str = ""
    digest: str = ""

    @classmethod
    def from_bag(cls, path: Path | str, rig: Rig) -> LoopRecord:
        """Read joint_states, joint_command and reference of a rig. Raises UserError where bag, topic, field or a number
        is missing, or stamps run backwards.
        """
        return _LoopReader(Path(path), rig).loop()

    @property
    def is_real_time(self) -> bool:
        """Whether stamps and log use the same clock, so that delays have a meaning."""
        return bool(np.isfinite(self.delay).any())

    @property
    def spells(self) -> list[tuple[float, float, str]]:
        """Start and stop [s] of each state in turn, to within the time between two diagnostics."""
        found: list[tuple[float, float, str]] = []
        for time, state in self.states:
            if found and found[-1][2] == state:
                found[-1] = (found[-1][0], time, state)
            else:
                start = found[-1][1] if found else time
                found.append((start, time, state))
        return found

    @property
    def tracked(self) -> list[int]:
        """The outputs that have a reference."""
        return np.flatnonzero(np.isfinite(self.reference).any(axis=0)).tolist()

    @property
    def error(self) -> Array:
        """Reference minus measured outputs, (samples, p)."""
        return self.reference - self.outputs

    def within(self, start: float, stop: float) -> NDArray[np.bool_]:
        """Samples from `start` up to, but without, `stop` [s]."""
        return (self.time >= start) & (self.time < stop)

    def tracking_rmse(self, start: float = 0.0, stop: float = np.inf, *, output: int | None = None) -> float:
        """Root mean square of reference minus measured output from `start` to `stop` [s], in the display unit.

        output: index of the output, by default the first that is tracked. Raises UserError where the bag has no sample
        with a reference there.
        """
        chosen = next(iter(self.tracked), 0) if output is None else output
        error = self.error[self.within(start, stop), chosen]
        error = error[np.isfinite(error)]
        if not len(error):
            raise UserError(
                f"{self.source}: no measurement with a reference from {start:g} to {stop:g} s: "
                f"the bag holds {self.time[0]:g} to {self.time[-1]:g} s"
            )
        return float(np.sqrt(np.mean(self.rig.display[chosen].shown(error) ** 2)))

    def missed_commands(self, start: float = 0.0, stop: float = np.inf) -> int:
        """Measurements from `start` to `stop` [s] that were not answered before the next one was logged."""
        return int(np.sum(self.late[self.within(start, stop)]))

    def delays(self, start: float = 0.0, stop: float = np.inf) -> Delays:
        """Percentiles of the delay from `start` to `stop` [s]."""
        return Delays.of(self.delay[self.within(start, stop)])

    def turnarounds(self, start: float = 0.0, stop: float = np.inf) -> Delays:
        """Percentiles of the turnaround from `start` to `stop` [s]."""
        return Delays.of(self.turnaround[self.within(start, stop)])


class _LoopReader:
    """The reading of one bag into a LoopRecord."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self.path = path
        self.rig = rig
        self.names = {topic: f"/{rig.namespace.strip('/')}/{topic}" for topic in (MEASUREMENT, COMMAND, REFERENCE)}
        motion = f"/{rig.namespace.strip('/')}/{MOTION}"
        with opened(path) as bag:
            messages = bag.whole([*self.names.values(), motion, DIAGNOSTICS])
        self.motion, self.diagnostics = messages.get(motion), messages.get(DIAGNOSTICS)
        for name in self.names.values():
            if name not in messages:
                raise UserError(
                    f"{self.path}: no topic {name}: the bag has {bag.listing}; a closed loop needs all of "
                    f"{', '.join(self.names.values())}"
                )
            if not messages[name].data:
                raise UserError(f"{self.path}: topic {name} has no messages: was its publisher running?")
        self.columns = {topic: TopicColumns(messages[name]) for topic, name in self.names.items()}

    def values(self, topic: str, field: str) -> Array:
        try:
            return self.columns[topic].values(field)
        except MissingInMessageError as error:
            raise UserError(f"{self.path}: topic {self.names[topic]}: field {field} is missing in {error}") from error

    def stamps(self, topic: str, field: str) -> NDArray[np.int64]:
        self.values(topic, field)  # the field is there in every message
        return self.columns[topic].stamps(field)

    def loop(self) -> LoopRecord:
        joints, system = self.rig.joints, self.rig.system
        places = [joints.place(item.name) for item in system.outputs]
        inputs = [_field(*joints.place(item.name)) for item in system.inputs]
        stamps, first = self.measurements(_field(*places[0]))
        logged = self.columns[MEASUREMENT].messages.logged[first]
        outputs = np.stack([self.outputs(place, stamps, first) for place in places], axis=1)
        applied = np.stack([self.values(MEASUREMENT, field)[first] for field in inputs], axis=1)
        answers, answered = self.answers(stamps, inputs[0])
        given = np.stack([self.finite(COMMAND, field)[answers] for field in inputs], axis=1)
        command = np.where(answered[:, None] >= 0, given, np.nan)
        replies = self.columns[COMMAND].messages.logged[answers]
        turnaround = np.where(answered >= 0, (replies - logged) * 1e-9, np.nan)
        one_clock = abs(np.median(logged - stamps)) <= ONE_CLOCK
        delay = np.where((answered >= 0) & one_clock, (replies - stamps) * 1e-9, np.nan)
        late = np.zeros(len(stamps), dtype=bool)
        late[:-1] = (answered[:-1] < 0) | (one_clock & (replies[:-1] >= logged[1:]))
        zero, reference = self.reference(stamps, places)
        return LoopRecord(
            name=name_of(self.path),
            rig=self.rig,
            stamps=stamps,
            time=np.asarray((stamps - zero) * 1e-9),
            outputs=outputs,
            reference=reference,
            inputs=np.concatenate([applied[1:], applied[-1:]]),
            command=command,
            delay=delay,
            turnaround=turnaround,
            late=late,
            states=tuple(((stamp - zero) * 1e-9, word) for stamp, word in self.states()),
            source=str(self.path),
            digest=sha256(self.path),
        )

    def measurements(self, field: str) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """Stamps of the measurements [ns], and the index of the message in which each came first, since some repeat."""
        stamps = self.stamps(MEASUREMENT, field)
        backwards = np.diff(stamps) < 0
        if backwards.any():
            k = int(np.argmax(backwards)) + 1
            raise UserError(
                f"{self.path}: topic {self.names[MEASUREMENT]}: reversed stamp at message {k} "
                f"({(stamps[k] - stamps[0]) * 1e-9:.6g} s): two runs in one bag, or two plants: record one alone"
            )
        found: tuple[NDArray[np.int64], NDArray[np.intp]] = np.unique(stamps, return_index=True)
        return found

    def outputs(self, place: tuple[str, str], stamps: NDArray[np.int64], first: NDArray[np.intp]) -> Array:
        """An output (samples,) from its joint and field, at the measurements' stamps, whose messages are ``first``."""
        field = _field(*place)
        if np.isnan(self.values(MEASUREMENT, field)).all() and self.motion is not None and place[1] == "position":
            following = replace(self.motion, data=self.motion.data[1:], logged=self.motion.logged[1:])
            columns = TopicColumns(following)  # the first has one state, others a period's steps
            newest = "points"
            try:
                newest = _points(place, columns.entries("points"))[-1]
                return np.interp(stamps, columns.stamps(newest), columns.values(newest))
            except MissingInMessageError as error:
                raise UserError(f"{self.path}: topic {MOTION}: {newest} is missing in {error}") from error
        return self.finite(MEASUREMENT, field)[first]

    def answers(self, stamps: NDArray[np.int64], field: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """For each measurement the index of the first command with its stamp, with 0 for none, and with -1 for none."""
        known, first = np.unique(self.stamps(COMMAND, field), return_index=True)
        place = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
        answered = np.where(known[place] == stamps, first[place], -1)
        return np.maximum(answered, 0), answered

    def reference(self, stamps: NDArray[np.int64], places: Sequence[tuple[str, str]]) -> tuple[int, Array]:
        """Time zero [ns], and references at each stamp (samples, p), from the joints and fields of the outputs."""
        try:
            count = self.columns[REFERENCE].entries("points")
        except MissingInMessageError as error:
            raise UserError(f"{self.path}: topic {self.names[REFERENCE]}: {error}") from error
        if not count:
            raise UserError(f"{self.path}: topic {self.names[REFERENCE]}: message 0 has no points")
        begins = [_points(place, 1)[0] for place in places]
        found = {k: _points(places[k], count) for k, field in enumerate(begins) if self.has(REFERENCE, field)}
        if not found:
            wanted = ", ".join(begins)
            raise UserError(f"{self.path}: topic {self.names[REFERENCE]}: has none of {wanted}: is it of this rig?")
        sent = self.stamps(REFERENCE, "header.stamp.sec")
        order = np.argsort(sent, kind="stable")[::-1]  # the newest message of equal times counts
        zero = int(sent.min())
        references = np.full((len(stamps), len(places)), np.nan)
        for k, fields in found.items():
            times = np.stack([self.stamps(REFERENCE, field) for field in fields], axis=1)
            values = np.stack([self.finite(REFERENCE, field) for field in fields], axis=1)
            known, newest = np.unique(times[order].ravel(), return_index=True)
            seconds = (known - zero) * 1e-9
            references[:, k] = np.interp((stamps - zero) * 1e-9, seconds, values[order].ravel()[newest], left=np.nan)
        return zero, references

    def states(self) -> Iterator[tuple[int, str]]:
        """The controller's states, as it reported them, with their stamps [ns]."""
        if self.diagnostics is None or self.diagnostics.type != "diagnostic_msgs/msg/DiagnosticArray":
            return
        for data in self.diagnostics.data:
            message: Any = jazzy_types().deserialize_cdr(data, self.diagnostics.type)
            stamp = message.header.stamp
            for status in message.status:
                if status.name.endswith("controller: loop"):
                    found = next((item.value for item in status.values if item.key == "state"), "")
                    if found:
                        yield stamp.sec * SECOND + stamp.nanosec, found

    def has(self, topic: str, field: str) -> bool:
        """Whether the messages have a field, and it is a number in the first."""
        try:
            return bool(np.isfinite(self.columns[topic].values(field)[0]))
        except MissingInMessageError:
            return False

    def finite(self, topic: str, field: str) -> Array:
        """A field of all messages. Raises UserError where one is not finite."""
        values = self.values(topic, field)
        if not np.isfinite(values).all():
            k = int(np.argmax(~np.isfinite(values)))
            raise UserError(f"{self.path}: topic {self.names[topic]}: {field} is {values[k]:g} in message {k}")
        return values


def _field(joint: str, field: str) -> str:
    """Path to a joint's entry of a list."""
    return f"{field}[{joint}]"


def _points(place: tuple[str, str], count: int) -> list[str]:
    """Paths to a joint's entry in each point of a trajectory."""
    joint, field = place
    plural = {"position": "positions", "velocity": "velocities", "effort": "effort"}[field]
    return [f"points[{point}].{plural}[{joint}]" for point in range(count)]
