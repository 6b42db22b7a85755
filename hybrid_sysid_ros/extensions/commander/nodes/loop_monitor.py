"""Loop monitor: where a running loop is, by the newest messages of its topics, fetched when somebody asks."""

from __future__ import annotations

from time import monotonic_ns, time_ns
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.node import Node

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.commander.language.command_interface import RigState
from hybrid_sysid_ros.extensions.commander.language.forecast import Start
from hybrid_sysid_ros.extensions.commander.nodes.controller_report import ControllerReport
from hybrid_sysid_ros.extensions.shared.nodes.collector import Collector
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.nodes.topics import TYPES
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SUBSCRIBES = ("state_estimate", "joint_command", "reference", "/diagnostics")
OBEYED = SECOND // 2
"""Within which a controller does what a service asks for [ns]; what it says until then may be of before."""
UNANSWERED = SECOND
"""Of estimates that no command has answered [ns], after which nothing moves."""


class LoopMonitor:
    """The newest estimate, command and reference of a rig; no message wakes the node."""

    def __init__(self, node: Node, rig: Rig, tracked: NDArray[np.bool_], *, silence: int) -> None:
        """tracked: outputs that have references (outputs,). silence: after which another publisher is heard [ns]."""
        self.rig, self.tracked = rig, tracked
        self.collectors = {topic: Collector(node, TYPES[topic], topic) for topic in SUBSCRIBES}
        self.validators = {
            topic: MessageValidator(TYPES[topic], steady=monotonic_ns, silence=silence) for topic in SUBSCRIBES
        }
        layout = SignalLayout(rig, rig.system)
        self.outputs, self.inputs = Slots(layout.outputs), Slots(layout.inputs)
        self.scales = np.array([display.scale for display in rig.display])
        self.newest: dict[str, Any] = {}
        self.published = 0
        """When the newest estimate was, in system time [ns]."""
        self.controller = ControllerReport()
        self._loop_task = f"{node.get_namespace()}/controller".strip("/") + ": loop"

    def close(self) -> None:
        """Hear nothing any more."""
        for collector in self.collectors.values():
            collector.close()

    def look(self) -> None:
        """Take in what has come."""
        for topic, collector in self.collectors.items():
            validator = self.validators[topic]
            for data, published in collector.fetch():
                message = validator.unpack(data)
                if topic == "/diagnostics":
                    self._take_report(message, published)
                elif message is not None and validator.accepts_source(message.source):
                    validator.select_source(message.source)
                    self.newest[topic] = message
                    self.published = published if topic == "state_estimate" else self.published

    def _take_report(self, message: DiagnosticArray | None, published: int) -> None:
        for status in message.status if message is not None and published >= self.controller.published else ():
            if status.name == self._loop_task:
                self.controller = ControllerReport.of(status, published)

    def expect(self, state: str, reason: str = "") -> None:
        """Take the controller for what a service has just asked it to be, until it says what it is."""
        self.controller = ControllerReport(state, reason, time_ns() + OBEYED)

    def heard_since(self, then: int, patience: float) -> bool:
        """Whether the controller has said what it does since a time [ns], or has not for so long after it [s]."""
        return self.controller.published > then or time_ns() - then > patience * SECOND

    @property
    def standstill(self) -> str:
        """That nothing moves, why, and what to do; "" where references are followed."""
        command = self.newest.get("joint_command")
        if self.controller.standstill or command is None or self.stamp - command.stamp < UNANSWERED:
            return self.controller.standstill
        seconds = (self.stamp - command.stamp) / SECOND
        return f"nothing moves: no command has come for {seconds:.2g} s: is the controller running?"

    @property
    def stamp(self) -> int:
        """Of the newest estimate [ns]; 0 before the first."""
        estimate = self.newest.get("state_estimate")
        return 0 if estimate is None else int(estimate.stamp)

    def _estimate(self) -> JointStates:
        found = self.newest.get("state_estimate")
        if found is None:
            raise UserError("no estimate has come yet: is the loop running?")
        return JointStates(*found)

    def all_outputs(self) -> Array:
        """All estimated outputs (outputs,), as they are shown. Raises UserError where there is no estimate."""
        estimate = self._estimate()
        found: Array = np.array(self.outputs.read(estimate.names, estimate.lists)) / self.scales
        return found

    def shown_outputs(self) -> Array:
        """The same, 0 for those that are not tracked. Raises UserError where there is no estimate."""
        values = self.all_outputs()
        if not np.isfinite(values[self.tracked]).all():
            raise UserError("the estimates are no numbers: see the estimator's diagnostics")
        return np.where(self.tracked, values, 0.0)

    def watched_outputs(self) -> Array:
        """All outputs (outputs,), as they are shown, 0 for unknown ones. Raises UserError without an estimate."""
        values = self.all_outputs()
        return np.where(self.tracked, self.shown_outputs(), np.where(np.isfinite(values), values, 0.0))

    def reference(self) -> Array:
        """What the outputs are asked to be now (outputs,), as they are shown. Raises UserError where nothing is."""
        message = self.newest.get("reference")
        if message is None:
            raise UserError("no reference is published yet: is the loop running, and its reference node?")
        preview = Preview.of(
            TrajectoryMessage(*message), self.validators["reference"], self.outputs, self.tracked, self.stamp
        )
        if preview is None:
            raise UserError("the reference makes no sense: see the controller's diagnostics")
        found: Array = preview.at(np.array([self.stamp]))[0] / self.scales
        return found

    def state(self) -> RigState:
        """Where the rig is. Raises UserError where there is no estimate or no reference."""
        names = [
            f"{item.name} [{shown.unit}]" for item, shown in zip(self.rig.system.outputs, self.rig.display, strict=True)
        ]
        wanted = zip(names, self.reference().tolist(), self.tracked, strict=True)
        given = zip(self.rig.system.inputs, self.commanded().tolist(), strict=True)
        return RigState(
            live=True,
            outputs=dict(zip(names, self.all_outputs().tolist(), strict=True)),
            references={name: value for name, value, tracked in wanted if tracked},
            inputs={f"{item.name} [{item.unit}]": value for item, value in given},
            standstill=self.standstill,
        )

    def start(self, system: System) -> Start:
        """The state of a model (n,), the inputs, and their offsets. Raises UserError where they are no numbers, or the
        estimates are of another model.
        """
        estimate, layout = self._estimate(), SignalLayout(self.rig, system)
        states, offsets = Slots(layout.states), Slots(layout.inputs)
        state, offset = (np.array(slots.read(estimate.names, estimate.lists)) for slots in (states, offsets))
        if states.named < len(states):
            absent = ", ".join(name for name in states.names if name not in estimate.names)
            raise UserError(f"the estimates have no {absent}: the estimator's model is another one than is simulated")
        if not np.isfinite(state).all():
            raise UserError("the estimates are no numbers: see the estimator's diagnostics")
        return Start(state=state, inputs=self.commanded(), disturbance=np.where(np.isfinite(offset), offset, 0.0))

    def commanded(self) -> Array:
        """The inputs (m,) of the newest command, at rest before the first."""
        command = self.newest.get("joint_command")
        rest = np.array([actuator.rest for actuator in self.rig.actuators])
        given = rest if command is None else np.array(self.inputs.read(command.names, command.lists))
        return np.where(np.isfinite(given), given, rest)
