"""Reference: publishes previews of the outputs' references."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.nodes.diagnostics import OK, Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.process import announce, run
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.nodes.timing import Timeline
from hybrid_sysid_ros.nodes.validation import StampOrder
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.runtime.references import length_of, signal_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CHOOSING = {"kind", "amplitude", "frequency", "hold", "seed"}  # parameters of a reference


class ChosenReference:
    """The reference that the parameters choose."""

    def __init__(self, settings: Mapping[str, Any], rig: Rig) -> None:
        """Raises UserError for an unknown kind, and for a multisine without room between its frequencies."""
        self.kind: str = settings["kind"] or rig.reference
        self.signal = signal_of(self.kind, settings, rig)
        self.duration = round((settings["duration"] or length_of(self.kind, rig)) * SECOND)
        """[ns]; 0: no end."""


class SetPoint:
    """A reference from the topic set_point, whose last point is held."""

    kind = "set_point"
    duration = 0

    def __init__(self, preview: Preview, zero: int, scales: Array) -> None:
        """zero: stamp of the reference's time 0 [ns]; scales: SI per shown unit (outputs,)."""
        self.preview, self.zero, self.scales = preview, zero, scales

    def signal(self, seconds: ArrayLike) -> Array:
        """The outputs in display units at times, as any reference gives them."""
        times = self.zero + np.round(np.asarray(seconds) * SECOND).astype(np.int64)
        return self.preview.at(times) / self.scales


class ReferenceNode(RigNode):
    """Publishes previews of the outputs that the rig's controller tracks, so that references have one publisher. They
    come from a reference by its kind, or from a set-point, a trajectory of the same joints, after it has come and until
    a kind is set. A set-point without a stamp begins when it comes.

    Time 0 of the reference is the stamp of the first measurement. Message i begins at i publish periods, so that all
    points of all messages are on one grid.
    """

    NAME = "reference"
    PUBLISHES = ("reference",)
    SUBSCRIBES = ("joint_states", "set_point")

    def configure(self) -> None:
        settings = self.settings
        self.spacing = round(settings["point_spacing"] * SECOND)
        self.period = round(settings["publish_period"] * SECOND)
        if self.period % self.spacing:
            raise UserError(
                f"parameter publish_period is {settings['publish_period']:g} s: "
                f"it must be a multiple of point_spacing, {settings['point_spacing']:g} s"
            )
        self.choose(ChosenReference(settings, self.rig))
        self.offsets = np.arange(round(settings["preview_seconds"] * SECOND) // self.spacing + 1) * self.spacing
        layout = SignalLayout(self.rig, self.rig.system)
        self.tracked = np.flatnonzero(defaults(self.rig, "controller")["output_weight"])
        self.scales = np.array([display.scale for display in self.rig.display])
        self.outputs = Slots(layout.outputs)
        slots = Slots([layout.outputs[k] for k in self.tracked])
        self.writer, self.preview = TrajectoryWriter(slots, self.offsets.tolist(), self.signature), b""
        self.measured = Slots([*layout.outputs, *layout.inputs])

    def choose(self, choice: ChosenReference) -> None:
        """Begin with another reference."""
        self.choice: ChosenReference | SetPoint = choice
        self.zero = self.sent = 0

    def prepare(self, settings: Mapping[str, Any], names: frozenset[str]) -> Callable[[], object]:
        if not names & CHOOSING:
            return super().prepare(settings, names)
        choice = ChosenReference(settings, self.rig)

        def begin() -> None:
            now = self.zero + self.timeline.elapsed() if self.active and self.zero else 0
            self.choose(choice)
            if now and not self.settings["lockstep"]:
                self.begin(now)

        return begin

    def activate(self) -> None:
        self.zero = self.sent = 0
        self.timeline = Timeline(self.now)
        self.previews = self.open("reference")
        self.entry = self.validator("joint_states")
        self.measurements = self.listen(self.entry, "joint_states", self.on_measurement)
        self.wishes = self.validator("set_point")
        self.listen(self.wishes, "set_point", self.on_set_point)
        if not self.settings["lockstep"]:
            self.every(self.settings["publish_period"], self.tick)

    def on_measurement(self, joints: JointStates) -> None:
        """Begin with the first measurement; in lockstep follow the stamps."""
        if self.zero and not self.settings["lockstep"]:
            return
        self.measured.read(joints.names, joints.lists)
        order = self.entry.admit(joints) if self.measured.named else None
        if order is None or order is StampOrder.LATE:
            return
        stamp = self.entry.stamp
        if not self.zero:
            self.begin(stamp)
            announce("begun")
        if order is StampOrder.DUPLICATE:  # it was not answered, maybe because a reference is missing
            self.previews.publish(self.preview)
        self.advance(stamp - self.zero)

    def on_set_point(self, message: TrajectoryMessage) -> None:
        """Follow a set-point from now on, and publish at once."""
        if not self.zero or not self.wishes.accepts_source(message.source):
            return
        elapsed = self.entry.stamp - self.zero if self.settings["lockstep"] else self.timeline.elapsed()
        tracked = np.isin(np.arange(len(self.scales)), self.tracked)
        preview = Preview.of(message, self.wishes, self.outputs, tracked, self.zero + elapsed)
        if preview is not None:
            self.wishes.select_source(message.source)
            self.choice = SetPoint(preview, self.zero, self.scales)
            self.publish(elapsed // self.spacing * self.spacing)

    def begin(self, stamp: int) -> None:
        """Set time 0 to a stamp [ns]."""
        self.zero = stamp
        self.timeline.begin(stamp)

    def tick(self) -> None:
        """Advance in real time, with stamps that follow the clock."""
        if not self.zero:
            return
        self.measurements.close()  # they have set the time and are not needed any more
        elapsed = self.timeline.follow()
        self.zero = self.timeline.start
        self.advance(elapsed)

    def advance(self, elapsed: int) -> None:
        """Publish if a message is due ``elapsed`` after the start [ns]; end when the reference has ended."""
        if self.choice.duration and elapsed >= self.choice.duration and not self.settings["stay"]:
            self.finish()
            return
        due = elapsed // self.period + 1
        if due > self.sent:
            self.sent = due
            self.publish((due - 1) * self.period)

    def publish(self, start: int) -> None:
        """Publish the preview that begins `start` after time 0 [ns]."""
        seconds = np.minimum(start + self.offsets, self.choice.duration or np.inf) / SECOND
        values = (self.scales * self.choice.signal(seconds))[:, self.tracked]
        self.preview = self.writer.pack(self.zero + start, values.tolist())
        self.previews.publish(self.preview)

    def close(self) -> None:
        """Log and announce the end of the reference."""
        ending = self.configured and not self.settings["stay"]
        if ending and self.choice.duration and self.sent * self.period >= self.choice.duration:
            self.get_logger().info(f"done after {self.choice.duration / SECOND:g} s")
        super().close()

    def health(self) -> Sequence[Task]:
        refused = dict(self.wishes.dropped)
        values = {
            "kind": self.choice.kind,
            "messages": self.sent,
            "seconds": self.sent * self.period / SECOND,
            "dropped_set_points": sum(refused.values()),
        }
        troubles = {f"set-points {reason.value}": count for reason, count in refused.items()}
        judged = self.judged("reference", troubles, self.sent, **values)
        if judged.level != OK:
            return [judged]
        started = "done" if self.finished.done() else "running"
        return [replace(judged, message=started if self.zero else "waiting for a measurement")]


main = partial(run, ReferenceNode)

if __name__ == "__main__":
    sys.exit(main())
