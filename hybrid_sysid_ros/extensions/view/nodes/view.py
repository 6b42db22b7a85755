"""View: shows a running rig on a page of this computer, and passes on what is asked for there."""

from __future__ import annotations

import asyncio
import math
import os
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import numpy as np
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.view import requests
from hybrid_sysid_ros.extensions.view.bag_recording import BagRecording
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.nodes.history import TOPICS, SignalHistory
from hybrid_sysid_ros.extensions.view.tables import Cursor
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.process import announce, run
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.runtime.references import KINDS
from hybrid_sysid_ros.support.errors import UserError

NICENESS = 10  # of the process: it comes after the loop
ANSWER_TIMEOUT = 5.0  # s, for an answer of another node
LOOK = 0.5  # s, between two looks who is there
OTHERS = ("plant", "controller", "reference")  # nodes whose parameters a page may set


class ViewNode(RigNode):
    """The rig's topics in; a page out, and from it set_point, parameters and services of the other nodes.

    No message wakes it: a few dozen times a second it fetches what has come. It is no part of the loop, which goes on
    without it and does not wait for it. Set-points go to the reference node, so that there is one publisher of
    ``reference`` still.
    """

    NAME = "view"
    PUBLISHES = ("set_point",)
    SUBSCRIBES = TOPICS

    def configure(self) -> None:
        self.drawing, self.offered = Drawing(self.rig), requests.RequestMenu.of(self.rig, KINDS)
        self.history = SignalHistory(self, self.drawing, self.offered)

    def activate(self) -> None:
        self.started, self.spent = monotonic(), process_time()
        self.history.open()
        self.set_points = self.open("set_point")
        self.setters = {node: self._client(SetParameters, f"{node}/set_parameters") for node in OTHERS}
        self.weights = self._client(GetParameters, "controller/get_parameters")
        self.calls = {service: self._client(Trigger, f"controller/{service}") for service in requests.SERVICES}
        self.recording = BagRecording(
            Path(self.settings["recordings"]),
            rig=self.rig.source,
            name=self.rig.name,
            namespace=self.get_namespace().strip("/"),
            priority=self.settings["priority"],
        )
        self.looked, self.answered = -math.inf, deque[dict[str, list[float]]]()
        """When it was last seen who is there [s], and what the controller has said of its weights since."""
        self.weighed = False
        """Whether the controller that is there was asked for its weights."""
        from hybrid_sysid_ros.extensions.view.server import Server  # says what to install, where that is missing

        self.server = Server(self, port=self.settings["port"], pictures=self.settings["pictures"])
        self.server.start()
        announce(self.server.url)

    def deactivate(self) -> None:
        """Close the pages, and the bag."""
        self.server.close()
        self.recording.close()
        for client in (*self.setters.values(), *self.calls.values(), self.weights):
            self.destroy_client(client)
        self.history.close()

    def _client(self, kind: type[Any], service: str) -> Client:
        return self.create_client(kind, service, callback_group=self.service_group)

    def greeting(self) -> Mapping[str, Any]:
        """What a page must know of the rig."""
        system, offer = self.rig.system, self.offered
        low, high = self.rig.limits
        return {
            "rig": self.rig.name,
            "outputs": [
                {
                    "name": output.name,
                    "unit": output.unit,
                    "tracked": output.tracked,
                    "low": output.low if output.tracked else None,
                    "high": output.high if output.tracked else None,
                    "travel": self._travel(k),
                }
                for k, output in enumerate(offer.outputs)
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
            "services": requests.SERVICES,
            "weights": [
                {
                    "name": name,
                    "low": item.low,
                    "high": item.high,
                    "of": [one.name for one in (system.outputs if item.each == "output" else system.inputs)],
                }
                for name, item in offer.weights.items()
            ],
            "period": 1.0 / defaults(self.rig, "plant")["rate"],
            "seconds": self.settings["seconds"],
            "curve": requests.CURVE,
            "points": requests.POINTS,
        }

    def _travel(self, k: int) -> list[float] | None:
        """Lowest and highest value of an output, as it is shown; None where the rig's file sets no end."""
        ends = sorted((self.rig.travel_of_outputs[:, k] / self.offered.outputs[k].scale).tolist())
        return ends if all(map(math.isfinite, ends)) else None

    def frame(self, cursor: Cursor) -> bytes:
        return self.history.tables.frame(cursor)

    def collect(self) -> None:
        """Take in what has come, and see now and then who is there."""
        self.history.collect()
        if monotonic() - self.looked > LOOK:
            self.looked = monotonic()
            self._look()

    def _look(self) -> None:
        """See who is there to answer a page, and tell the page."""
        tables, there = self.history.tables, self.weights.service_is_ready()
        if there and not self.weighed:
            asked = self.weights.call_async(GetParameters.Request(names=list(requests.WEIGHTS)))
            asked.add_done_callback(self._hear_weights)
        self.weighed = there
        while self.answered:
            self.history.learn_weights(self.answered.popleft())
        self.history.see_silence()
        tables.replace("recording", self.recording.facts())
        tables.replace(
            "there",
            {
                "services": [name for name, client in self.calls.items() if client.service_is_ready()],
                "nodes": [name for name, client in self.setters.items() if client.service_is_ready()],
                "set_points": self.set_points.get_subscription_count() > 0,
            },
        )

    def _hear_weights(self, answer: Any) -> None:
        """Not in the thread of the server, which takes it in at its next look."""
        values = [list(value.double_array_value) for value in answer.result().values]
        self.answered.append(dict(zip(requests.WEIGHTS, values, strict=False)))

    async def act(self, request: requests.Request) -> str:
        """Do what a page asks for; a line about it. Raises UserError where it can't be, or is refused."""
        if isinstance(request, requests.SetPointRequest):
            return self._set_point(request)
        if isinstance(request, requests.ReferenceRequest):
            return await self._set("reference", {"kind": request.kind}, f"{request.kind} begins")
        if isinstance(request, requests.PolicyChoice):
            return await self._set("controller", {"policy": request.policy}, f"{request.policy} drives")
        if isinstance(request, requests.Fault):
            values = self.offered.faults[request.name]
            given = values if request.on else {key: self.offered.sound[key] for key in values}
            return await self._set("plant", given, f"{request.name}: {'on' if request.on else 'off'}")
        if isinstance(request, requests.ServiceCall):
            answer = await self._ask(self.calls[request.service], Trigger.Request(), "controller")
            if not answer.success:
                raise UserError(f"controller: {answer.message}")
            return answer.message or f"controller: {request.service}"
        if isinstance(request, requests.WeightChange):
            values = self.offered.weights[request.name].checked(request.values)
            said = ", ".join(f"{value:g}" for value in values)
            return await self._set("controller", {request.name: values}, f"{request.name} is {said}")
        if isinstance(request, requests.RecordRequest):
            return await (self.recording.start() if request.on else self.recording.stop())
        raise UserError(f"{request.do}: nobody does that")

    def _set_point(self, request: requests.SetPointRequest) -> str:
        if not self.set_points.get_subscription_count():
            raise UserError("no reference node is there to follow a set-point: start one")
        offsets = [round(time * SECOND) for time in request.times]
        history = self.history
        writer = TrajectoryWriter(history.referred, offsets, self.signature)
        rows = np.array(request.values) * history.scales[history.tracked]
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
