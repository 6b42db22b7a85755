"""View: shows a running rig on a page of this computer, and passes on what is asked for there."""

from __future__ import annotations

import asyncio
import math
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from time import monotonic, monotonic_ns, process_time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.requests import (
    CURVE,
    POINTS,
    SERVICES,
    Fault,
    PolicyChoice,
    ReferenceRequest,
    Request,
    RequestMenu,
    ServiceCall,
    SetPointRequest,
)
from hybrid_sysid_ros.extensions.view.tables import Cursor, Tables
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.process import announce, run
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, SignalPlace, Slots
from hybrid_sysid_ros.nodes.subscriptions import Collector
from hybrid_sysid_ros.nodes.topics import TYPES
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.runtime.references import KINDS
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NICENESS = 10  # of the process: it comes after the loop
ANSWER_TIMEOUT = 5.0  # s, for an answer of another node
REMEMBERED = 512  # measurements whose commands may yet come
STATUSES, VALUES = 40, 200  # tasks in the diagnostics, and numbers of each, at most


class ViewNode(RigNode):
    """The rig's topics in; a page out, and from it set_point, parameters and services of the other nodes.

    No message wakes it: a few dozen times a second it fetches what has come. It is no part of the loop, which goes on
    without it and does not wait for it. Set-points go to the reference node, so that there is one publisher of
    ``reference`` still.
    """

    NAME = "view"
    PUBLISHES = ("set_point",)
    SUBSCRIBES = (
        "joint_states", "state_estimate", "joint_command", "reference", "predicted_trajectory", "/diagnostics",
    )  # fmt: skip

    def configure(self) -> None:
        rig, settings = self.rig, self.settings
        self.drawing, self.offered = Drawing(rig), RequestMenu.of(rig, KINDS)
        layout = SignalLayout(rig, rig.system)
        outputs, inputs = len(layout.outputs), len(layout.inputs)
        self.scales = np.array([output.scale for output in self.offered.outputs])
        self.tracked = [k for k, output in enumerate(self.offered.outputs) if output.tracked]
        self.measured = Slots([*layout.outputs, *layout.inputs])
        self.integrated = np.array([not rig.joints.joints[name].position for name in self.drawing.joints], dtype=bool)
        """Whether a joint has no position in messages, so that its velocity is added up."""
        joints = [
            SignalPlace(name, "velocity" if integrated else "position")
            for name, integrated in zip(self.drawing.joints, self.integrated, strict=True)
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
        self.tables = Tables(columns, capacity=round(settings["seconds"] * defaults(rig, "plant")["rate"]))

    def activate(self) -> None:
        self.started, self.spent = monotonic(), process_time()
        self.published: dict[int, int] = {}
        """Of the last measurements: when they were published, by their stamps [ns]."""
        self.preview = np.empty((0, 1 + len(self.tracked)))
        """The newest reference, as it is shown."""
        self.epoch = -1
        """Of the tables, when it came."""
        self.statuses: set[str] = set()
        """Names of the tasks that diagnostics have told of."""
        self.collectors = {topic: Collector(self, TYPES[topic], topic) for topic in self.SUBSCRIBES}
        given = {"steady": monotonic_ns, "silence": self.settings["silence"] * SECOND}  # whatever the stamps
        self.validators |= {topic: MessageValidator(TYPES[topic], **given) for topic in self.SUBSCRIBES}
        self.set_points = self.open("set_point")
        self.setters = {
            node: self._client(SetParameters, f"{node}/set_parameters") for node in ("plant", "controller", "reference")
        }
        self.calls = {service: self._client(Trigger, f"controller/{service}") for service in SERVICES}
        from hybrid_sysid_ros.extensions.view.server import Server  # says what to install, where that is missing

        self.server = Server(self, port=self.settings["port"], pictures=self.settings["pictures"])
        self.server.start()
        announce(self.server.url)

    def deactivate(self) -> None:
        """Close the pages."""
        self.server.close()
        for client in (*self.setters.values(), *self.calls.values()):
            self.destroy_client(client)
        for collector in self.collectors.values():
            collector.close()

    def _client(self, kind: type[Any], service: str) -> Client:
        return self.create_client(kind, service, callback_group=self.service_group)

    def greeting(self) -> Mapping[str, Any]:
        """What a page must know of the rig."""
        system, offer = self.rig.system, self.offered
        low, high = self.rig.limits
        return {
            "rig": self.rig.name,
            "outputs": [
                {"name": output.name, "unit": output.unit, "tracked": output.tracked}
                | {"low": output.low if output.tracked else None, "high": output.high if output.tracked else None}
                for output in offer.outputs
            ],
            "inputs": [
                {"name": item.name, "unit": item.unit, "low": float(low[k]), "high": float(high[k])}
                for k, item in enumerate(system.inputs)
            ],
            "joints": self.drawing.joints,
            "drawing": self.drawing.description(),
            "extent": list(self.drawing.extent()),
            "kinds": offer.kinds,
            "faults": offer.faults,
            "policies": offer.policies,
            "period": 1.0 / defaults(self.rig, "plant")["rate"],
            "seconds": self.settings["seconds"],
            "curve": CURVE,
            "points": POINTS,
        }

    def frame(self, cursor: Cursor) -> bytes:
        return self.tables.frame(cursor)

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
            scales = np.concatenate([self.scales, np.ones(len(self.rig.actuators))])
            self.tables.replace("prediction", self._rows(message, self.measured, scales))
        for data, _ in self.collectors["/diagnostics"].fetch():
            said = self.validators["/diagnostics"].unpack(data)
            if said is not None:
                self._diagnose(said)

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
        if joints.stamp:
            self.tables.tables["command"].add([self.tables.time(joints.stamp), *values, delay])

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
        if self.epoch == self.tables.epoch:
            for row in self.preview[self.preview[:, 0] < rows[0, 0]]:
                self.tables.tables["asked"].add(row)
        self.preview, self.epoch = rows, self.tables.epoch
        self.tables.replace("reference", rows)

    def _rows(self, message: TrajectoryMessage, slots: Slots, scales: Array) -> Array:
        """Of each point its time and its numbers, as they are shown (points, 1 + slots)."""
        begin = self.tables.time(message.stamp or self.now())
        columns = [np.broadcast_to(row, message.times.shape) for row in slots.read(message.names, message.lists)]
        return np.column_stack([begin + message.times / SECOND, np.column_stack(columns) / scales])

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, task = status.name.rpartition(": ")
            if status.hardware_id != self.rig.name or len(status.values) > VALUES:
                continue
            if len(self.statuses | {status.name}) > STATUSES:
                continue
            self.statuses.add(status.name)
            said = {
                "node": node.rpartition("/")[2],
                "task": task,
                "level": status.level[0],
                "line": status.message[:500],
                "values": {item.key: item.value[:100] for item in status.values},
            }
            self.tables.replace(f"status {status.name}", said)

    async def act(self, request: Request) -> str:
        """Do what a page asks for; a line about it. Raises UserError where it can't be, or is refused."""
        if isinstance(request, SetPointRequest):
            return self._set_point(request)
        if isinstance(request, ReferenceRequest):
            return await self._set("reference", {"kind": request.kind}, f"{request.kind} begins")
        if isinstance(request, PolicyChoice):
            return await self._set("controller", {"policy": request.policy}, f"{request.policy} drives")
        if isinstance(request, Fault):
            values = self.offered.faults[request.name]
            given = values if request.on else {key: self.offered.sound[key] for key in values}
            return await self._set("plant", given, f"{request.name}: {'on' if request.on else 'off'}")
        if isinstance(request, ServiceCall):
            answer = await self._ask(self.calls[request.service], Trigger.Request(), "controller")
            if not answer.success:
                raise UserError(f"controller: {answer.message}")
            return answer.message or f"controller: {request.service}"
        raise UserError(f"{request.do}: nobody does that")

    def _set_point(self, request: SetPointRequest) -> str:
        if not self.set_points.get_subscription_count():
            raise UserError("no reference node is there to follow a set-point: start one")
        offsets = [round(time * SECOND) for time in request.times]
        writer = TrajectoryWriter(self.referred, offsets, self.signature)
        rows = np.array(request.values) * self.scales[self.tracked]
        self.set_points.publish(writer.pack(0, rows.tolist()))  # without a stamp: it begins when it comes
        return "set-point" if len(offsets) == 1 else "curve"

    async def _set(self, node: str, values: Mapping[str, Any], line: str) -> str:
        """Set parameters of a node, all or none."""
        wanted = [RosParameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = await self._ask(self.setters[node], SetParameters.Request(parameters=wanted), node)
        refused = [result.reason for result in answer.results if not result.successful]
        if refused:
            raise UserError(f"{node}: {refused[0]}")
        return line

    async def _ask(self, client: Client, request: Any, node: str) -> Any:
        """Another node's answer. Raises UserError where there is none."""
        if not client.service_is_ready():
            raise UserError(f"no {node} is there that answers {client.srv_name}")
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def take(answer: Any) -> None:
            if not answered.done():
                answered.set_result(answer)

        def pass_on(future: Any) -> None:
            loop.call_soon_threadsafe(take, future.result())

        asked = client.call_async(request)
        asked.add_done_callback(pass_on)
        try:
            return await asyncio.wait_for(answered, ANSWER_TIMEOUT)
        except asyncio.TimeoutError:
            client.remove_pending_request(asked)
            raise UserError(f"{node} does not answer for {ANSWER_TIMEOUT:g} s") from None

    @property
    def signature(self) -> str:
        """As in real time: what is asked for on a page does not repeat."""
        return f"{self.get_fully_qualified_name()} {os.getpid()}"

    def health(self) -> Sequence[Task]:
        server, seconds = self.server, monotonic() - self.started
        values = {
            "port": server.port,
            "pages": len(server.pages),
            "pictures": server.sent,
            "refused_requests": server.refused,
            "seconds": seconds,
            "cpu_share": (process_time() - self.spent) / max(seconds, 1e-9),
        }
        return [Task(name="view", values=values)]


def make() -> ViewNode:
    """Make the node, and let it give way: not the middleware's threads, which are there by then."""
    node = ViewNode()
    os.nice(NICENESS)
    return node


main = partial(run, make)

if __name__ == "__main__":
    sys.exit(main())
