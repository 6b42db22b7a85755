"""Command client: says commands to the commander of a running loop, and hears its replies."""

from __future__ import annotations

import argparse
import os
import sys
from queue import Empty, Queue
from threading import Thread
from time import monotonic
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply, RigState
from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal
from hybrid_sysid_ros.extensions.commander.nodes.loop_monitor import LoopMonitor
from hybrid_sysid_ros.extensions.commander.nodes.plan_writer import tracked_outputs
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.middleware import prepare_middleware
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

THERE_TIMEOUT = 3.0  # s, until a commander is heard of
ANSWER_TIMEOUT = 5.0  # s, for the answer of a service
REPLY_TIMEOUT = 120.0  # s, for the simulation of the longest plan
SILENCE = 1.0  # s, after which another publisher is heard
FINAL = ("refused", "waits", "begins", "stopped")
"""States of replies that answer a command."""


class CommandClient(CommandInterface):
    """The commander of a running loop, as whoever speaks sees it; its node spins in a thread of its own."""

    def __init__(self, rig: Rig) -> None:
        """Raises UserError where the rig has no commander."""
        self._rig, namespace = rig, rig.namespace
        self._rehearsal: Rehearsal | None = None
        if not rclpy.ok():
            prepare_middleware()
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("speaker", namespace=namespace, enable_rosout=False, start_parameter_services=False)
        self._replies: Queue[DiagnosticStatus] = Queue()
        self._setter = self._node.create_client(SetParameters, "commander/set_parameters")
        self._stop = self._node.create_client(Trigger, "commander/stop")
        self._confirm = self._node.create_client(Trigger, "commander/confirm")
        quality = topics.profile("command_reply")
        self._heard = self._node.create_subscription(DiagnosticStatus, "command_reply", self._replies.put, quality)
        self._monitor = LoopMonitor(self._node, rig, tracked_outputs(rig), silence=round(1e9 * SILENCE))
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._spinning = Thread(target=self._spin, daemon=True)
        self._spinning.start()
        end = monotonic() + THERE_TIMEOUT
        while not (self._setter.service_is_ready() and self._node.count_publishers("command_reply")):
            if monotonic() > end:
                self.close()
                raise UserError(
                    f"no commander is there in /{namespace}: start one with the loop (hybrid-sysid run --commander), "
                    "or say --dry"
                )
            self._node.get_clock().sleep_for(rclpy.duration.Duration(seconds=0.02))

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except (ExternalShutdownException, ShutdownException):
            return

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._spinning.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def say(self, text: str) -> Reply:
        while not self._replies.empty():
            self._replies.get_nowait()
        wanted = Parameter("command", value=text).to_parameter_msg()
        answer = self._ask(self._setter, SetParameters.Request(parameters=[wanted]))
        (result,) = answer.results
        if not result.successful:
            return Reply(text=text, accepted=False, line=str(result.reason))
        return self._reply(text)

    def check(self, text: str) -> Reply:
        if self._rehearsal is None:
            self._rehearsal = Rehearsal.of(self._rig, folder=os.getcwd())
        self._monitor.look()
        try:
            start, reference = self._monitor.start(self._rehearsal.system), self._monitor.reference()
        except UserError as error:
            return Reply(text=text, accepted=False, line=str(error))
        return self._rehearsal.check_from(text, start, reference)

    def state(self) -> RigState:
        self._monitor.look()
        tracked = [item for item, one in zip(self._rig.system.outputs, self._monitor.tracked, strict=True) if one]
        units = {item.name: shown.unit for item, shown in zip(self._rig.system.outputs, self._rig.display, strict=True)}
        values = zip(self._rig.system.outputs, self._monitor.all_outputs().tolist(), strict=True)
        wanted = zip(self._rig.system.outputs, self._monitor.reference().tolist(), strict=True)
        named = zip(self._rig.system.inputs, self._monitor.start(self._rig.system).inputs.tolist(), strict=True)
        return RigState(
            live=True,
            outputs={f"{item.name} [{units[item.name]}]": value for item, value in values},
            references={f"{item.name} [{units[item.name]}]": value for item, value in wanted if item in tracked},
            inputs={f"{item.name} [{item.unit}]": value for item, value in named},
        )

    def stop(self) -> Reply:
        answer = self._ask(self._stop, Trigger.Request())
        return Reply(text="stop", accepted=bool(answer.success), line=str(answer.message))

    def confirm(self) -> Reply:
        answer = self._ask(self._confirm, Trigger.Request())
        return Reply(text="confirm", accepted=bool(answer.success), line=str(answer.message) or "begins")

    def _reply(self, text: str) -> Reply:
        """What the simulation of a command said."""
        end = monotonic() + REPLY_TIMEOUT
        while (left := end - monotonic()) > 0.0:
            try:
                status = self._replies.get(timeout=left)
            except Empty:
                break
            values = {item.key: item.value for item in status.values}
            if values.pop("text", None) == text[:300] and (state := values.pop("state", "")) in FINAL:
                numbers = {name: float(value) for name, value in values.items()}
                return Reply(text=text, accepted=state != "refused", line=f"{state}: {status.message}", values=numbers)
        raise UserError(f"the commander does not reply for {REPLY_TIMEOUT:g} s")

    def _ask(self, client: Any, request: Any) -> Any:
        """The answer of a service. Raises UserError where there is none."""
        answered: Queue[Any] = Queue()
        client.call_async(request).add_done_callback(lambda future: answered.put(future.result()))
        try:
            return answered.get(timeout=ANSWER_TIMEOUT)
        except Empty:
            raise UserError(f"the commander does not answer for {ANSWER_TIMEOUT:g} s") from None


def main() -> int:
    """Say one command, or serve commands to language models; the exit status, 2 for a refusal."""
    parser = argparse.ArgumentParser(prog="speaker", description=__doc__)
    parser.add_argument("rig")
    parser.add_argument("--say", default="")
    parser.add_argument("--confirm", action="store_true")
    parser.add_argument("--serve", action="store_true")
    asked = parser.parse_args()
    try:
        rig = rigs.load(asked.rig)
        speaker = CommandClient(rig)
        if asked.serve:
            from hybrid_sysid_ros.extensions.commander.language.server import server

            server(rig, speaker).run()
            status = 0
        else:
            status = speak(speaker, asked.say, confirm=asked.confirm)
        speaker.close()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except KeyboardInterrupt:
        return 130
    return status


def speak(desk: CommandClient, text: str, *, confirm: bool) -> int:
    """Say one command and print the reply; the exit status."""
    reply = desk.say(text)
    if confirm and reply.accepted and reply.line.startswith("waits"):
        print(reply.line, flush=True)
        reply = desk.confirm()
    if not reply.accepted:
        print(f"error: {reply.line}", file=sys.stderr, flush=True)
        return 2
    print(reply.line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
