"""Commander: takes commands in plain language, simulates them, and lets the reference node carry out what passes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from threading import Lock, RLock, Thread
from time import monotonic, monotonic_ns
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from hybrid_sysid_ros.extensions.commander.language.commands import Sentence
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast, Start
from hybrid_sysid_ros.extensions.commander.language.grammar import read
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.commander.nodes.command_replies import CommandReplies
from hybrid_sysid_ros.extensions.commander.nodes.configured_interpreter import ConfiguredInterpreter, give_way
from hybrid_sysid_ros.extensions.commander.nodes.controller_services import ControllerServices
from hybrid_sysid_ros.extensions.commander.nodes.loop_monitor import SUBSCRIBES, LoopMonitor
from hybrid_sysid_ros.extensions.commander.nodes.plan_writer import PlanWriter
from hybrid_sysid_ros.extensions.commander.nodes.waiting_commands import AwaitedCommand, ReadyCommand
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Task
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LOOK_PERIOD = 0.05  # s, between two looks how far a plan is
WAITING = 60.0  # s, that a plan waits to be confirmed
JUST = 0.5  # s, that the beginning of a plan may take


class CommanderNode(RigNode):
    """command_text, the parameter ``command`` and services in; set_point, command_reply and planned out.

    A text is read at once; what is not understood, or beyond the rig's limits, is refused with the reason. The rest is
    simulated in a thread of its own, one command at a time, with the parameters that estimator and controller have.
    What passes is carried out where the commander is armed, and waits for the service ``confirm`` where not. It
    publishes no reference: plans go to the reference node, as set-points do.

    Stop goes before everything: it needs no simulation, waits for none, and works in every state of this node. It calls
    the controller's service, drops every plan, disarms, and lets the reference stay where the outputs are.
    """

    NAME = "commander"
    PUBLISHES = ("set_point", "command_reply", "planned")
    SUBSCRIBES = ("command_text", *SUBSCRIBES)

    def __init__(self, **options: Any) -> None:
        self.ready: ReadyCommand | None = None
        self.running: ReadyCommand | None = None
        self.awaited: AwaitedCommand | None = None
        self.checking = ""
        self.stops = self.refused = self.carried_out = 0
        self.stopped = self.armed = False
        self.staying = False
        """Whether the reference has yet to stay where a stop found the outputs."""
        self.started = self.turn = 0
        self._simulating = Lock()
        self._lock = RLock()
        """Nothing begins between a stop and what it drops."""
        super().__init__(**options)
        self.vocabulary = Vocabulary.of(self.rig)
        read("stop", self.vocabulary)  # its words are loaded now, not when somebody says it
        self.controller = ControllerServices(self)
        self.create_service(Trigger, "~/stop", self.on_stop)
        self.create_service(SetBool, "~/arm", self.on_arm)

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        return {"home": partial(self.obey, "home"), "confirm": self.confirm}

    @property
    def signature(self) -> str:
        """As in real time: what people say does not repeat."""
        return f"{self.get_fully_qualified_name()} {os.getpid()}"

    def configure(self) -> None:
        self.writer = PlanWriter(self.rig, self.signature)
        self.ranges = set_point_ranges(self.rig)
        self.armed = self.settings["armed"]

    def activate(self) -> None:
        silence = round(self.settings["silence"] * SECOND)
        self.monitor = LoopMonitor(self, self.rig, self.writer.tracked, silence=silence)
        self.set_points, self.planned = self.open("set_point"), self.open("planned")
        self.replies = CommandReplies(self)
        self.validators["command_text"] = entry = MessageValidator(String, steady=monotonic_ns)  # people have no stamps
        self.listen(entry, "command_text", self.on_text)
        self.interpreting = ConfiguredInterpreter(self)
        self.every(LOOK_PERIOD, self.look)

    def deactivate(self) -> None:
        """Leave what runs to the reference node, which holds its last value."""
        self.turn += 1
        self.interpreting.close()
        self.monitor.close()
        self.ready = self.running = self.awaited = None

    # What is said.

    def on_text(self, message: String) -> None:
        """A command by topic; what is wrong with it is reported on command_reply."""
        with suppress(UserError):  # reported already
            self.obey(message.data)

    def accept(self, given: Mapping[str, Any], fixed: Sequence[str]) -> None:
        """A command by parameter: what is wrong with it is the reason why the parameter is not set."""
        if not given.get("command", "").strip():
            super().accept(given, fixed)
        elif len(given) > 1:
            raise UserError("parameter command: set it alone")
        else:
            self.obey(given["command"])

    def prepare(self, settings: Mapping[str, Any], names: frozenset[str]) -> Callable[[], object]:
        return partial(self.arm, settings["armed"]) if "armed" in names else super().prepare(settings, names)

    def arm(self, armed: bool) -> None:
        """Carry out at once what passes from now on, or let it wait for ``confirm``."""
        self.armed = armed

    def obey(self, text: str) -> None:
        """Read a command, and begin to check it. Raises UserError where it is refused, which is also reported on
        command_reply.
        """
        try:
            self._obey(text)
        except UserError as error:
            self.refuse(text, error)
            raise

    def _obey(self, text: str) -> None:
        interpreter = self.interpreting.interpreter if self.active else None
        if interpreter is not None:
            self._act(interpreter.read(text))
            return
        sentence = read(text, self.vocabulary)
        if not sentence.ends_in_stop:  # what goes before a stop can't be carried out now
            raise UserError(self.interpreting.missing if self.active else f"the commander is {self.state}: activate it")
        self.stop(text, emergency=sentence.emergency, because=sentence.because)

    def _act(self, sentence: Sentence) -> None:
        """Stop, or plan and begin to check; raises UserError for what is refused."""
        text, interpreter = sentence.text, self.interpreting.interpreter
        if sentence.is_stop:
            self.stop(text, emergency=sentence.emergency, because=sentence.because)
            return
        if interpreter is None:
            raise UserError(self.interpreting.missing)
        sentence = interpreter.unfolded(sentence)
        with self._lock:
            if self.checking:
                raise UserError(f"{self.checking[:60]!r} is still being checked: wait for its reply, or say stop")
            self.monitor.look()
            self.awaited = self.guard
            if self.guard is not None and sentence.later is not None:
                raise UserError(f"{self.guard.sentence.text!r} waits still, and one condition is watched: say stop")
            plan = interpreter.plan(sentence, self.here())
            words = self.story(interpreter, sentence, plan)
            if not sentence.commands and sentence.later is not None:  # what runs goes on meanwhile
                self.wait_for(sentence)
                self.reply(text, "waits", words, OK, {})
                return
            self.reply(text, "checks", words, OK, {})
            start = self.monitor.start(interpreter.simulator.model.system)
            self.checking, self.ready = text, None
            self.turn += 1
        Thread(target=self.check, args=(interpreter, sentence, plan, start, self.turn), daemon=True).start()

    @property
    def guard(self) -> AwaitedCommand | None:
        """The stop that waits for a condition, if there is one: other commands leave it."""
        return self.awaited if self.awaited is not None and self.awaited.sentence.is_stop else None

    def story(self, interpreter: Interpreter, sentence: Sentence, plan: ReferencePlan) -> str:
        """What was understood, and which stop waits beside it."""
        beside = f"; {self.guard.sentence.text!r} waits still" if self.guard is not None else ""
        return f"{interpreter.story(sentence, plan)}{beside}"

    def here(self) -> Array:
        """Where a plan begins (outputs,): at the reference, or, after a stop, where the outputs are."""
        return self.monitor.shown_outputs() if self.stopped else self.monitor.reference()

    def check(self, interpreter: Interpreter, sentence: Sentence, plan: ReferencePlan, start: Start, turn: int) -> None:
        """Simulate a plan; runs in a thread of its own."""
        give_way()
        try:
            with self._simulating:  # what a stop has dropped may still be simulated, by the same controller
                forecast = interpreter.forecast(plan, start)
            self.in_loop(partial(self.passed, interpreter, sentence, plan, forecast, turn))
        except Exception as error:
            self.in_loop(partial(self.failed, sentence, error, turn))

    def failed(self, sentence: Sentence, error: Exception, turn: int) -> None:
        """The simulation says no."""
        if turn == self.turn:
            self.checking = ""
            self.refuse(sentence.text, error)

    def passed(
        self, interpreter: Interpreter, sentence: Sentence, plan: ReferencePlan, forecast: Forecast, turn: int
    ) -> None:
        """The simulation says yes: carry it out, or wait for somebody to confirm it."""
        with self._lock:
            if turn != self.turn:
                return  # stopped meanwhile
            self.checking = ""
            words = f"{self.story(interpreter, sentence, plan)}: {forecast.line}"
            self.ready = ReadyCommand(sentence=sentence, plan=plan, forecast=forecast, since=monotonic(), words=words)
            self.planned.publish(self.writer.forecast(forecast))
            if not self.armed:
                words += "; waits for confirm (hybrid-sysid call confirm)"
                self.reply(sentence.text, "waits", words, WARN, forecast.values)
                return
            try:
                self.confirm()
            except UserError as error:
                self.refuse(sentence.text, error)

    def confirm(self) -> None:
        """Carry out the plan that waits. Raises UserError where none does, or it is out of date."""
        with self._lock:
            ready, interpreter = self.ready, self.interpreting.interpreter
            if ready is None or interpreter is None or monotonic() - ready.since > WAITING:
                self.ready = None
                raise UserError("nothing waits to be confirmed: give a command first")
            self.monitor.look()
            plan, here = ready.plan, self.here()
            words = ready.words
            if (np.abs(here - plan.values[0]) > 1e-6).any():  # it has moved on: from here, within the same limits
                plan = interpreter.plan(ready.sentence, here)
                words = f"{self.story(interpreter, ready.sentence, plan)}: {ready.forecast.line}"
            if not self.set_points.get_subscription_count():
                raise UserError("no reference node is there to follow a plan: start one")
            if self.stopped:
                self.controller.call(self.controller.enabler)
            self.reply(ready.sentence.text, "begins", words, OK, ready.forecast.values)  # before anything moves
            self.set_points.publish(self.writer.set_point(plan))
            self.stopped = self.staying = False
            self.ready = None
            interpreter.note(ready.sentence, plan.values[0])
            self.running = replace(ready, plan=plan, since=monotonic(), words=words)
            if ready.sentence.guards:
                self.wait_for(ready.sentence, plan.duration)
            self.started = self.monitor.stamp
            self.carried_out += 1

    def look(self) -> None:
        """See how far the plan is."""
        self.monitor.look()
        if self.settings["armed"] != self.armed:  # by a stop, or the service
            self.set_parameters([Parameter("armed", value=self.armed)])
        if self.staying:
            self.staying = False
            self.stay()
        self.look_for_condition()
        running = self.running
        if running is None or self.monitor.stamp - self.started < running.plan.duration * SECOND:
            return
        self.running = None
        if running.plan.stops:
            self.stop(running.sentence.text)
        else:
            self.reply(running.sentence.text, "done", "done", OK, {})
        if not running.sentence.guards:
            self.wait_for(running.sentence)

    # Conditions.

    def wait_for(self, sentence: Sentence, ahead: float = 0.0) -> None:
        """From now on, until the condition of a sentence comes true or its time is over, which begins ``ahead`` [s]
        later.
        """
        if sentence.later is not None and sentence.condition is not None:
            self.awaited = AwaitedCommand(
                condition=sentence.condition, sentence=sentence.later, since=monotonic() + ahead,
                begin=self.monitor.shown_outputs(),
            )  # fmt: skip

    def look_for_condition(self) -> None:
        """Carry out what waits, where its condition has come true; leave it out where its time is over."""
        with self._lock:
            awaited = self.awaited
            if awaited is None or self.checking:
                return
            try:
                shown, idle = self.monitor.shown_outputs(), self.running is None
                if awaited.is_due(monotonic(), shown, self.ranges, idle=idle):
                    self.awaited = None
                    self._act(awaited.sentence)
            except UserError as error:
                self.awaited = None
                self.refuse(awaited.sentence.text, error)

    # Stop.

    def on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """In every state, in a thread that nothing else holds up."""
        try:
            self.stop("stop")
            response.success = True
        except UserError as error:
            response.message = str(error)
        return response

    def stop(self, text: str, *, emergency: bool = False, because: str = "") -> None:
        """Inputs to rest; in an emergency, until the controller is reset and armed. because: of a stop that nobody
        asked for at once. Raises UserError where there is no controller.
        """
        self.turn += 1
        stopper = self.controller.latcher if emergency else self.controller.stopper
        try:
            self.controller.call(stopper)
        finally:
            with self._lock:
                started = self.running is not None and monotonic() - self.running.since < JUST
                self.stops += 1
                self.armed, self.stopped, self.checking = False, True, ""
                self.ready = self.running = self.awaited = None
        if started:  # which may have enabled the controller after that
            self.controller.call(stopper)
        if self.active:
            latched = ", and the controller until it is reset and armed" if emergency else ""
            words = f"the inputs go to rest; the commander is disarmed{latched}{because}"
            self.reply(text, "stopped", words, OK, {})
            self.staying = True

    def stay(self) -> None:
        """Let the reference stay where the outputs are."""
        with suppress(UserError):  # without estimates nothing says where that is
            here = self.monitor.shown_outputs()
            self.set_points.publish(self.writer.set_point(ReferencePlan(times=np.zeros(1), values=here[None])))

    def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """From now on plans that pass are carried out at once, or wait to be confirmed."""
        self.arm(bool(request.data))
        response.success, response.message = True, "armed" if self.armed else "disarmed"
        return response

    # What is published.

    def refuse(self, text: str, error: Exception) -> None:
        """Say why not."""
        self.refused += 1
        self.reply(text, "refused", self.words_of(error), ERROR, {})

    def reply(self, text: str, state: str, line: str, level: bytes, values: Mapping[str, float]) -> None:
        """On command_reply, while the node is active."""
        if self.active:
            self.replies.send(text, state, line, level, values)

    def health(self) -> Sequence[Task]:
        state = "running" if self.running else "stopped" if self.stopped else "idle"
        state = "waits for a condition" if self.awaited else state
        state = "checking" if self.checking else "waits for confirm" if self.ready else state
        ready = "ready" if self.interpreting.interpreter is not None else self.interpreting.missing
        values = {
            "armed": self.armed, "state": state, "carried_out": self.carried_out, "refused": self.refused,
            "stops": self.stops,
        }  # fmt: skip
        return [Task(name="commander", level=OK, message=f"{ready}, {state}", values=values)]


main = partial(run, CommanderNode)

if __name__ == "__main__":
    sys.exit(main())
