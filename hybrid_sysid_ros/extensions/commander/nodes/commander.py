"""Commander: takes commands in plain language, simulates them, and lets the reference node carry out what passes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from threading import Lock, Thread
from time import monotonic, monotonic_ns
from typing import Any

from std_msgs.msg import String
from std_srvs.srv import SetBool

from hybrid_sysid_ros.extensions.commander.language.commands import Sentence
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast, Start
from hybrid_sysid_ros.extensions.commander.language.grammar import read
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.questions import answered
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.commander.nodes.command_replies import CommandReplies
from hybrid_sysid_ros.extensions.commander.nodes.configured_interpreter import ConfiguredInterpreter, give_way
from hybrid_sysid_ros.extensions.commander.nodes.loop_monitor import SUBSCRIBES, LoopMonitor
from hybrid_sysid_ros.extensions.commander.nodes.plan_execution import PlanExecution
from hybrid_sysid_ros.extensions.commander.nodes.waiting_commands import ReadyCommand
from hybrid_sysid_ros.nodes.diagnostics import OK, WARN, Task
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.support.errors import UserError

LOOK_PERIOD = 0.05  # s, between two looks how far a plan is


class CommanderNode(PlanExecution):
    """command_text, the parameter ``command`` and services in; set_point, command_reply and planned out.

    A text is read at once; what is not understood, or beyond the rig's limits, is refused with the reason. The rest is
    simulated in a thread of its own, one command at a time, with the parameters that estimator and controller have.
    What passes is carried out where the commander is armed, and waits for the service ``confirm`` where not.
    """

    NAME = "commander"
    PUBLISHES = ("set_point", "command_reply", "planned")
    SUBSCRIBES = ("command_text", *SUBSCRIBES)

    def __init__(self, **options: Any) -> None:
        self._simulating = Lock()
        super().__init__(**options)
        self.vocabulary = Vocabulary.of(self.rig)
        read("stop", self.vocabulary)  # its words are loaded now, not when somebody says it
        self.create_service(SetBool, "~/arm", self.on_arm)

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        return {"home": partial(self.obey, "home"), "confirm": self.confirm}

    @property
    def signature(self) -> str:
        """As in real time: what people say does not repeat."""
        return f"{self.get_fully_qualified_name()} {os.getpid()}"

    def configure(self) -> None:
        super().configure()
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
            self.act(interpreter.read(text))
            return
        sentence = read(text, self.vocabulary)
        if not sentence.ends_in_stop:  # what goes before a stop can't be carried out now
            raise UserError(self.interpreting.missing if self.active else f"the commander is {self.state}: activate it")
        self.stop(text, emergency=sentence.emergency, because=sentence.because)

    def act(self, sentence: Sentence) -> None:
        """Stop, or plan and begin to check; raises UserError for what is refused."""
        text, interpreter = sentence.text, self.interpreting.interpreter
        if sentence.is_stop:
            self.stop(text, emergency=sentence.emergency, because=sentence.because)
            return
        if sentence.asks:
            self.monitor.look()
            self.reply(text, "answered", answered(self.monitor.state(), self.rig), OK, {})
            return
        if interpreter is None:
            raise UserError(self.interpreting.missing)
        sentence = interpreter.unfolded(sentence)
        with self._lock:
            if self.checking:
                raise UserError(f"{self.checking[:60]!r} is still being checked: wait for its reply, or say stop")
            self.monitor.look()
            if sentence.moves:
                self.check_moves()
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

    def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """From now on plans that pass are carried out at once, or wait to be confirmed."""
        self.arm(bool(request.data))
        response.success, response.message = True, "armed" if self.armed else "disarmed"
        return response

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
