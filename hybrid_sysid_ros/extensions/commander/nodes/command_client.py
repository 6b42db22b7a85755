"""Command client: says commands to the commander of a running loop, and hears its replies."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from queue import Empty, Queue
from threading import Thread
from time import monotonic, sleep, time_ns
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply, RigState
from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.questions import answered, is_question
from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, STOP, stop_in
from hybrid_sysid_ros.extensions.commander.nodes.loop_monitor import LoopMonitor
from hybrid_sysid_ros.extensions.commander.nodes.plan_writer import tracked_outputs
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.middleware import prepare_middleware
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import parameters
from hybrid_sysid_ros.support.errors import UserError

THERE_TIMEOUT = 3.0  # s, until a commander is heard of
STOP_TIMEOUT = 1.0  # s, until whoever says stop says it to the controller
POLL_PERIOD = 0.02  # s, between two looks whether it is
ANSWER_TIMEOUT = 5.0  # s, for the answer of a service
REPLY_TIMEOUT = 120.0  # s, for the simulation of the longest plan
SILENCE = 1.0  # s, after which another publisher is heard
LIVE = 2.0  # s, within which a running loop publishes estimates
NODES = ("controller", "estimator", "commander")
"""Whose parameters a preview takes."""
FINAL = ("refused", "waits", "begins", "answered", "stopped")
"""States of replies that answer a command."""


class CommandClient(CommandInterface):
    """The commander of a running loop, as whoever speaks sees it; its node spins in a thread of its own."""

    def __init__(self, rig: Rig, *, context: Context | None = None, stops: bool = False) -> None:
        """context: of its node, which is shut down with it; the process's own by default. stops: whether it is there to
        say stop, which goes to the controller where the rig has no commander. Raises UserError where it has none, else.
        """
        self._rig, namespace = rig, rig.namespace
        self._rehearsal: Rehearsal | None = None
        self._known: dict[str, dict[str, Any]] = {}
        """Parameters of the nodes, by which the rehearsal simulates."""
        self._context = context or rclpy.get_default_context()
        if not self._context.ok():
            prepare_middleware()
            rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            "speaker", context=self._context, namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self._waiting: list[Queue[DiagnosticStatus]] = []
        """Of replies, one for each command that waits for its own."""
        self._setter = self._node.create_client(SetParameters, "commander/set_parameters")
        self._stop = self._node.create_client(Trigger, "commander/stop")
        self._confirm = self._node.create_client(Trigger, "commander/confirm")
        self._stoppers = {
            kind: self._node.create_client(Trigger, f"controller/{name}")
            for kind, name in ((STOP, "stop"), (EMERGENCY, "estop"))
        }
        self._getters = {name: self._node.create_client(GetParameters, f"{name}/get_parameters") for name in NODES}
        quality = topics.profile("command_reply")
        self._heard = self._node.create_subscription(DiagnosticStatus, "command_reply", self._hear, quality)
        self._monitor = LoopMonitor(self._node, rig, tracked_outputs(rig), silence=round(1e9 * SILENCE))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._spinning = Thread(target=self._spin, daemon=True)
        self._spinning.start()
        end = monotonic() + THERE_TIMEOUT
        while not (self._setter.service_is_ready() and self._node.count_publishers("command_reply")):
            if stops and self._stoppers[STOP].service_is_ready():
                if monotonic() > end - THERE_TIMEOUT + STOP_TIMEOUT:
                    return
            elif monotonic() > end:
                self.close()
                raise UserError(
                    f"no commander is there in /{namespace}: start one with the loop (hybrid-sysid run --commander), "
                    "or say --dry"
                )
            sleep(POLL_PERIOD)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except (ExternalShutdownException, ShutdownException, InvalidHandle):
            return  # closed, at whatever moment of a turn

    def _hear(self, status: DiagnosticStatus) -> None:
        for replies in tuple(self._waiting):
            replies.put(status)

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._spinning.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def say(self, text: str) -> Reply:
        if (said := stop_in(text)) and not self._setter.service_is_ready():
            answer = self._ask(self._stoppers[said], Trigger.Request())
            line = f"stopped: {answer.message or 'the inputs go to rest'} (no commander answered)"
            return Reply(text=text, accepted=bool(answer.success), line=line)
        replies: Queue[DiagnosticStatus] = Queue()
        self._waiting.append(replies)
        try:
            wanted = Parameter("command", value=text).to_parameter_msg()
            answer = self._ask(self._setter, SetParameters.Request(parameters=[wanted]))
            (result,) = answer.results
            if not result.successful:
                return Reply(text=text, accepted=False, line=str(result.reason))
            return self._reply(text, replies)
        finally:
            self._waiting.remove(replies)

    def check(self, text: str) -> Reply:
        try:
            if is_question(text):
                return Reply(text=text, accepted=True, line=answered(self.state(), self._rig))
            rehearsal = self._configured()
            self._look()
            start, reference = self._monitor.start(rehearsal.system), self._monitor.reference()
        except UserError as error:
            return Reply(text=text, accepted=False, line=str(error))
        reply, still = rehearsal.check_from(text, start, reference), self._monitor.standstill
        return replace(reply, line=f"{reply.line}; but {still}") if reply.accepted and still else reply

    def _configured(self) -> Rehearsal:
        """What simulates as the commander does, by the parameters that the nodes have now. Raises UserError where one
        of them is missing.
        """
        known = {name: self._parameters(name) for name in ("controller", "estimator")}
        known["commander"] = self._parameters("commander", "folder", "layers")
        if self._rehearsal is None or known != self._known:
            simulator = Simulator.configured(self._rig, known["controller"], known["estimator"])
            self._rehearsal, self._known = Rehearsal(Interpreter.of(simulator, **known["commander"])), known
        return self._rehearsal

    def _parameters(self, name: str, *wanted: str) -> dict[str, Any]:
        """Of a node, all by default. Raises UserError where it is not there, or has not declared them yet."""
        if not self._getters[name].service_is_ready():
            raise UserError(f"no {name} is there: is the loop running?")
        wanted = wanted or tuple(parameters(self._rig, name))
        values = self._ask(self._getters[name], GetParameters.Request(names=wanted)).values
        if len(values) < len(wanted):
            raise UserError(f"the {name} still starts: say it again in some seconds")
        return dict(zip(wanted, map(parameter_value_to_python, values), strict=True))

    def _look(self) -> None:
        """Take in what has come. Raises UserError where the loop has ended."""
        self._monitor.look()
        silent = 1e-9 * (time_ns() - self._monitor.published)
        if self._monitor.published and silent > LIVE:
            raise UserError(f"no estimate has come for {silent:.3g} s: is the loop running?")

    def state(self) -> RigState:
        self._look()
        return self._monitor.state()

    def stop(self) -> Reply:
        answer = self._ask(self._stop, Trigger.Request())
        return Reply(text="stop", accepted=bool(answer.success), line=str(answer.message))

    def confirm(self) -> Reply:
        answer = self._ask(self._confirm, Trigger.Request())
        return Reply(text="confirm", accepted=bool(answer.success), line=str(answer.message) or "begins")

    def _reply(self, text: str, replies: Queue[DiagnosticStatus]) -> Reply:
        """What the simulation of a command said, or that a stop has dropped it."""
        end = monotonic() + REPLY_TIMEOUT
        while (left := end - monotonic()) > 0.0:
            try:
                status = replies.get(timeout=left)
            except Empty:
                break
            values = {item.key: item.value for item in status.values}
            own, state = values.pop("text", None) == text[:300], values.pop("state", "")
            if own and state in FINAL:
                numbers = {name: float(value) for name, value in values.items()}
                return Reply(text=text, accepted=state != "refused", line=f"{state}: {status.message}", values=numbers)
            if state == "stopped":
                return Reply(text=text, accepted=False, line=f"dropped by a stop: {status.message}")
        raise UserError(f"the commander does not reply for {REPLY_TIMEOUT:g} s")

    def _ask(self, client: Any, request: Any) -> Any:
        """The answer of a service of the loop. Raises UserError where there is none."""
        answered: Queue[Any] = Queue()
        client.call_async(request).add_done_callback(lambda future: answered.put(future.result()))
        try:
            return answered.get(timeout=ANSWER_TIMEOUT)
        except Empty:
            raise UserError(f"{client.srv_name} does not answer for {ANSWER_TIMEOUT:g} s") from None


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
        speaker = CommandClient(rig, stops=bool(stop_in(asked.say)))
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
