"""History: what a rig has said lately, as a page shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from time import monotonic, monotonic_ns

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent

from hybrid_sysid_ros.extensions.shared.nodes.collector import Collector
from hybrid_sysid_ros.extensions.view.controller_state import ControllerState
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.requests import WEIGHTS, RequestMenu
from hybrid_sysid_ros.extensions.view.tables import Tables
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, SignalPlace, Slots
from hybrid_sysid_ros.nodes.topics import TYPES
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.support.arrays import Array

TOPICS = (
    "joint_states", "state_estimate", "joint_command", "reference", "predicted_trajectory", "/diagnostics",
    "/parameter_events",
)  # fmt: skip
REMEMBERED = 512  # measurements whose commands may yet come
SILENT = 2.0  # s without a status of the controller
STATUSES, VALUES = 40, 200  # tasks in the diagnostics, and numbers of each, at most


class SignalHistory:
    """Takes a rig's topics in when it is told to: the last seconds of its signals, and the newest of what replaces what
    was before. No message wakes it.
    """

    def __init__(self, node: RigNode, drawing: Drawing, offered: RequestMenu) -> None:
        """node: whose topics are taken, from open() on."""
        self._node, rig = node, node.rig
        layout = SignalLayout(rig, rig.system)
        outputs, inputs = len(layout.outputs), len(layout.inputs)
        self.scales = np.array([output.scale for output in offered.outputs])
        self.tracked = [k for k, output in enumerate(offered.outputs) if output.tracked]
        self.measured = Slots([*layout.outputs, *layout.inputs])
        self.integrated = np.array([not rig.joints.joints[name].position for name in drawing.joints], dtype=bool)
        """Whether a joint has no position in messages, so that its velocity is added up."""
        joints = [
            SignalPlace(name, "velocity" if integrated else "position")
            for name, integrated in zip(drawing.joints, self.integrated, strict=True)
        ]
        self.estimated = Slots([*layout.outputs, *layout.inputs, *joints])
        self.positions, self.moved = np.zeros(len(joints)), 0.0
        self.commanded = Slots(layout.inputs)
        self.referred = Slots([layout.outputs[k] for k in self.tracked])
        columns = {
            "measured": 1 + outputs + inputs,
            "estimate": 1 + outputs + inputs + len(joints),
            "command": 1 + inputs + 1,
            "asked": 1 + len(self.tracked),
        }
        capacity = round(node.settings["seconds"] * defaults(rig, "plant")["rate"])
        self.tables = Tables(columns, capacity=capacity)

    def open(self) -> None:
        """Hear the topics from now on."""
        self.published: dict[int, int] = {}
        """Of the last measurements: when they were published, by their stamps [ns]."""
        self.preview = np.empty((0, 1 + len(self.tracked)))
        """The newest reference, as it is shown."""
        self.epoch = -1
        """Of the tables, when it came."""
        self.statuses: set[str] = set()
        """Names of the tasks that diagnostics have named."""
        self.controller, self.weights = ControllerState(), dict[str, list[float]]()
        self.heard = 0.0
        """When the controller reported its state last [s]; 0: not yet, or too long ago."""
        self.collectors = {topic: Collector(self._node, TYPES[topic], topic) for topic in TOPICS}
        given = {"steady": monotonic_ns, "silence": self._node.settings["silence"] * SECOND}  # whatever the stamps
        self.validators = {topic: MessageValidator(TYPES[topic], **given) for topic in TOPICS}

    def close(self) -> None:
        """Hear nothing any more."""
        for collector in self.collectors.values():
            collector.close()

    def collect(self) -> None:
        """Take in what has come, measurements first: they tell when time begins anew."""
        for joints, published in self._joints("joint_states"):
            self._measure(joints, published)
        for joints, _ in self._joints("state_estimate"):
            self._estimate(joints)
        for joints, published in self._joints("joint_command"):
            self._command(joints, published)
        for message in self._trajectories("reference"):
            self._refer(self._rows(message, self.referred, self.scales[self.tracked]))
        for message in self._trajectories("predicted_trajectory")[-1:]:
            scales = np.concatenate([self.scales, np.ones(len(self._node.rig.actuators))])
            self.tables.replace("prediction", self._rows(message, self.measured, scales))
        for topic, learn in (("/diagnostics", self._diagnose), ("/parameter_events", self._set)):
            for data, _ in self.collectors[topic].fetch():
                said = self.validators[topic].unpack(data)
                if said is not None:
                    learn(said)

    def _joints(self, topic: str) -> Sequence[tuple[JointStates, int]]:
        """What has come of joints, of the one publisher that is heard, and when it was published."""
        validator, found = self.validators[topic], []
        for data, published in self.collectors[topic].fetch():
            joints = validator.unpack(data)
            if joints is not None and validator.accepts_source(joints.source):
                validator.select_source(joints.source)
                found.append((joints, published))
        return found

    def _measure(self, joints: JointStates, published: int) -> None:
        values = self.validators["joint_states"].read(joints, self.measured)
        if values is None:
            return
        self.published[joints.stamp] = published
        if len(self.published) > REMEMBERED:
            del self.published[next(iter(self.published))]
        time, outputs = self.tables.time(joints.stamp, leads=True), len(self.scales)
        shown = np.divide(values[:outputs], self.scales)
        self.tables.tables["measured"].add([time, *shown.tolist(), *values[outputs:]])

    def _estimate(self, joints: JointStates) -> None:
        values = self.validators["state_estimate"].read(joints, self.estimated)
        if values is None:
            return
        time, outputs = self.tables.time(joints.stamp), len(self.scales)
        if math.isnan(time):
            return
        moving = np.array(values[len(self.measured) :])
        passed = time - self.moved
        step = np.where(np.isfinite(moving), moving, 0.0) * (passed if 0.0 < passed < 1.0 else 0.0)
        self.positions = np.where(self.integrated, self.positions + step, moving)
        self.moved = time
        shown = np.divide(values[:outputs], self.scales)
        row = [time, *shown.tolist(), *values[outputs : len(self.measured)], *self.positions.tolist()]
        self.tables.tables["estimate"].add(row)

    def _command(self, joints: JointStates, published: int) -> None:
        values = self.validators["joint_command"].read(joints, self.commanded)
        if values is None:
            return
        began = self.published.pop(joints.stamp, None)
        delay = math.nan if began is None else 1e3 * (published - began) / SECOND
        time = self.tables.time(joints.stamp) if joints.stamp else math.nan
        if not math.isnan(time):
            self.tables.tables["command"].add([time, *values, delay])

    def _trajectories(self, topic: str) -> Sequence[TrajectoryMessage]:
        """What has come of trajectories, of the one publisher that is heard."""
        validator, found = self.validators[topic], []
        for data, _ in self.collectors[topic].fetch():
            message = validator.unpack(data)
            if message is not None and validator.accepts_source(message.source) and len(message.times):
                validator.select_source(message.source)
                found.append(message)
        return found

    def _refer(self, rows: Array) -> None:
        """A new preview (points, 1 + tracked): what the one before asked for until then is past."""
        if math.isnan(rows[0, 0]):
            return
        if self.epoch == self.tables.epoch:
            for row in self.preview[self.preview[:, 0] < rows[0, 0]]:
                self.tables.tables["asked"].add(row)
        self.preview, self.epoch = rows, self.tables.epoch
        self.tables.replace("reference", rows)

    def _rows(self, message: TrajectoryMessage, slots: Slots, scales: Array) -> Array:
        """Of each point its time and its numbers, as they are shown (points, 1 + slots)."""
        begin = self.tables.time(message.stamp or self._node.now())
        columns = [np.broadcast_to(row, message.times.shape) for row in slots.read(message.names, message.lists)]
        return np.column_stack([begin + message.times / SECOND, np.column_stack(columns) / scales])

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, task = status.name.rpartition(": ")
            if status.hardware_id != self._node.rig.name or len(status.values) > VALUES:
                continue
            if len(self.statuses | {status.name}) > STATUSES:
                continue
            self.statuses.add(status.name)
            node, values = node.rpartition("/")[2], {item.key: item.value[:200] for item in status.values}
            said = {"node": node, "task": task, "level": status.level[0], "line": status.message[:500]}
            self.tables.replace(f"status {status.name}", {**said, "values": values})
            if (node, task) == ("controller", "loop"):
                state, reason = self.controller.read(status.message, values)
                self.tables.replace("controller", {"state": state, "reason": reason[:500]})
                self.heard = monotonic()

    def _set(self, event: ParameterEvent) -> None:
        """Learn what somebody has set of the controller."""
        if event.node == self._node.resolve_service_name("controller"):
            changed = [*event.new_parameters, *event.changed_parameters]
            self.learn_weights({item.name: list(item.value.double_array_value) for item in changed})

    def see_silence(self) -> None:
        """Tell when the controller says nothing more: what it said last is no state of now."""
        if self.heard and monotonic() - self.heard > SILENT:
            self.heard = 0.0
            reason = f"nothing has come from the controller for {SILENT:g} s"
            self.tables.replace("controller", {"state": "silent", "reason": reason})

    def learn_weights(self, values: Mapping[str, list[float]]) -> None:
        """Parameters of the controller, of which only its weights are shown."""
        found = {name: value for name, value in values.items() if name in WEIGHTS and value}
        if found:
            self.weights |= found
            self.tables.replace("weights", dict(self.weights))
