"""Plan execution: carries plans out that have passed, sees how far they are, and stops; the reference node follows."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from threading import RLock
from time import monotonic, time_ns
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.commander.language.commands import Sentence
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.extensions.commander.nodes.command_replies import CommandReplies
from hybrid_sysid_ros.extensions.commander.nodes.configured_interpreter import ConfiguredInterpreter
from hybrid_sysid_ros.extensions.commander.nodes.controller_services import ControllerServices
from hybrid_sysid_ros.extensions.commander.nodes.loop_monitor import LoopMonitor
from hybrid_sysid_ros.extensions.commander.nodes.plan_writer import PlanWriter
from hybrid_sysid_ros.extensions.commander.nodes.waiting_commands import AwaitedCommand, ReadyCommand
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WAITING = 60.0  # s, that a plan waits to be confirmed
JUST = 0.5  # s, that the beginning of a plan may take
REPORTED = 1.0  # s, within which a controller says what it does


class PlanExecution(RigNode):
    """Plans go to the reference node, as set-points do; this node publishes no reference. A plan begins only where the
    controller lets something move, and is broken off where it does so no more.

    Stop goes before everything: it needs no simulation, waits for none, and works in every state of this node. It calls
    the controller's service, drops every plan, disarms, and lets the reference stay where the outputs are.
    """

    interpreting: ConfiguredInterpreter
    monitor: LoopMonitor
    replies: CommandReplies
    set_points: Any

    def __init__(self, **options: Any) -> None:
        self.ready: ReadyCommand | None = None
        self.running: ReadyCommand | None = None
        self.awaited: AwaitedCommand | None = None
        self.checking = ""
        self.stops = self.refused = self.carried_out = 0
        self.stopped = self.armed = False
        self.own_stops = 0
        """Stops that the controller was asked for, with the last one from here; 0 until it says."""
        self.staying = False
        """Whether the reference has yet to stay where a stop found the outputs."""
        self.started = self.ended = self.turn = 0
        """Stamp of the plan's beginning, system time of its end, 0 before [ns], and a count of what was begun."""
        self._lock = RLock()
        """Nothing begins between a stop and what it drops."""
        super().__init__(**options)
        self.controller = ControllerServices(self)
        self.create_service(Trigger, "~/stop", self.on_stop)

    def configure(self) -> None:
        self.writer = PlanWriter(self.rig, self.signature)
        self.ranges = set_point_ranges(self.rig)

    def act(self, sentence: Sentence) -> None:
        """Stop, or plan and begin to check; raises UserError for what is refused."""
        raise NotImplementedError

    def confirm(self) -> None:
        """Carry out the plan that waits. Raises UserError where none does, or it is out of date."""
        with self._lock:
            ready, interpreter = self.ready, self.interpreting.interpreter
            if ready is None or interpreter is None or monotonic() - ready.since > WAITING:
                self.ready = None
                raise UserError("nothing waits to be confirmed: give a command first")
            self.monitor.look()
            self.check_moves()
            plan, here = ready.plan, self.here()
            words = ready.words
            if (np.abs(here - plan.values[0]) > 1e-6).any():  # it has moved on: from here, within the same limits
                plan = interpreter.plan(ready.sentence, here)
                words = f"{self.story(interpreter, ready.sentence, plan)}: {ready.forecast.line}"
            if not self.set_points.get_subscription_count():
                raise UserError("no reference node is there to follow a plan: start one")
            if self.stopped:
                self.controller.call(self.controller.enabler)
                self.monitor.expect("driving")
            self.reply(ready.sentence.text, "begins", words, OK, ready.forecast.values)  # before anything moves
            self.set_points.publish(self.writer.set_point(plan))
            self.stopped = self.staying = False
            self.ready = None
            interpreter.note(ready.sentence, plan.values[0])
            self.running = replace(ready, plan=plan, since=monotonic(), words=words)
            if ready.sentence.guards:
                self.wait_for(ready.sentence, plan.duration)
            self.started, self.ended = self.monitor.stamp, 0
            self.carried_out += 1

    def look(self) -> None:
        """See how far the plan is."""
        self.monitor.look()
        self.look_for_other_stops()
        if self.settings["armed"] != self.armed:  # by a stop, or the service
            self.set_parameters([Parameter("armed", value=self.armed)])
        if self.staying:
            self.staying = False
            self.stay()
        self.look_for_condition()
        running, still = self.running, self.monitor.standstill
        if running is None:
            return
        if still:
            self.break_off(running.sentence.text, still)
            return
        if self.monitor.stamp - self.started < running.plan.duration * SECOND:
            return
        self.ended = self.ended or time_ns()
        if not running.plan.stops and not self.monitor.heard_since(self.ended, REPORTED):
            return  # it may have stopped meanwhile
        self.running = None
        if running.plan.stops:
            self.stop(running.sentence.text)
        else:
            slowed = self.monitor.controller.slowed
            self.reply(running.sentence.text, "done", f"done{slowed}", WARN if slowed else OK, {})
        if not running.sentence.guards:
            self.wait_for(running.sentence)

    def look_for_other_stops(self) -> None:
        """What somebody else stops behind a stop from here is not enabled from here."""
        report = self.monitor.controller
        if self.stopped and report.stops:
            self.own_stops = self.own_stops or report.stops
            self.stopped = report.stops == self.own_stops and report.state in ("stopped", "disarmed")

    def check_moves(self) -> None:
        """Raise UserError where the controller lets nothing move; a stop from here is taken back by what begins."""
        still = self.monitor.standstill
        if still and not (self.stopped and self.monitor.controller.state == "stopped"):
            raise UserError(still)

    def break_off(self, text: str, why: str) -> None:
        """Drop what is carried out, since nothing moves; a stop that waits for a condition waits on."""
        with self._lock:
            self.turn += 1
            self.ready, self.running, self.awaited, self.checking = None, None, self.guard, ""
            self.staying = True
        self.reply(text, "stopped", f"broken off: {why}", WARN, {})

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

    # Conditions.

    def wait_for(self, sentence: Sentence, ahead: float = 0.0) -> None:
        """From now on, until the condition of a sentence comes true or its time is over, which begins ``ahead`` [s]
        later.
        """
        if sentence.later is not None and sentence.condition is not None:
            self.awaited = AwaitedCommand(
                condition=sentence.condition, sentence=sentence.later, since=monotonic() + ahead,
                begin=self.monitor.watched_outputs(),
            )  # fmt: skip

    def look_for_condition(self) -> None:
        """Carry out what waits, where its condition has come true; leave it out where its time is over."""
        with self._lock:
            awaited = self.awaited
            if awaited is None or self.checking:
                return
            try:
                shown, idle = self.monitor.watched_outputs(), self.running is None
                if awaited.is_due(monotonic(), shown, self.ranges, idle=idle):
                    self.awaited = None
                    self.act(awaited.sentence)
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
        by_others = self.active and self.monitor.controller.state == "stopped" and not self.stopped
        stopper = self.controller.latcher if emergency else self.controller.stopper
        try:
            self.controller.call(stopper)
        finally:
            with self._lock:
                started = self.running is not None and monotonic() - self.running.since < JUST
                self.stops += 1
                self.armed, self.stopped, self.checking = False, not by_others, ""
                self.own_stops = 0
                self.ready = self.running = self.awaited = None
        if started:  # which may have enabled the controller after that
            self.controller.call(stopper)
            self.own_stops = 0  # the controller may have said how many there were in between
        if self.active:
            latched = ", and the controller until it is reset and armed" if emergency else ""
            latch = "the commander's emergency stop is latched: call the services reset and arm"
            if emergency or not by_others:
                self.monitor.expect("disarmed" if emergency else "stopped", latch if emergency else "by the commander")
            words = f"the inputs go to rest; the commander is disarmed{latched}{because}"
            self.reply(text, "stopped", words, OK, {})
            self.staying = True

    def stay(self) -> None:
        """Let the reference stay where the outputs are."""
        with suppress(UserError):  # without estimates nothing says where that is
            here = self.monitor.shown_outputs()
            self.set_points.publish(self.writer.set_point(ReferencePlan(times=np.zeros(1), values=here[None])))

    # What is published.

    def refuse(self, text: str, error: Exception) -> None:
        """Say why not."""
        self.refused += 1
        self.reply(text, "refused", self.words_of(error), ERROR, {})

    def reply(self, text: str, state: str, line: str, level: bytes, values: Mapping[str, float]) -> None:
        """On command_reply, while the node is active."""
        if self.active:
            self.replies.send(text, state, line, level, values)
