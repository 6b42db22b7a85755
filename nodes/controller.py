"""Controller: answers every estimate with a command."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from threading import get_ident
from time import monotonic_ns, perf_counter, sleep
from typing import Any

import numpy as np
from std_msgs.msg import Bool

from hybrid_sysid_ros.control import MpcSolution
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.control.safety.supervisor import LAYERS
from hybrid_sysid_ros.estimation.suspicion import LONGEST
from hybrid_sysid_ros.nodes.adapters import ControllerAdapter
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.command_output import CommandOutput
from hybrid_sysid_ros.nodes.controller_health import HELD, NO_REFERENCE, RESTED, STOPPED, ZEROED, loop_tasks, unready
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage
from hybrid_sysid_ros.nodes.operation import ControllerMode, Operation
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.process import announce, run
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.nodes.validation import StampOrder
from hybrid_sysid_ros.support.arrays import Array

WATCH_PERIOD = 0.05  # s, between two looks whether estimates still come
SHOW_PERIOD = 0.1  # s, between two predicted trajectories
TIMES = {"stale_after", "zero_after", "stop_seconds", "warn_share", "error_share", "stale_seconds"}  # not the adapter's
STANDING_IN = {"shifted plan", "held"}  # layers that may stand in for zero_after, no longer
REFERENCE_PATIENCE = 3 * SECOND  # that a controller waits for somebody who gives references


class ControllerNode(RigNode):
    """state_estimate and reference in; joint_command out with the stamp of the estimate. A reader of effort_command
    gets its bare numbers, as ros2_control's forward_command_controller takes them.

    The answer comes from the first of these layers that has one, and each use is counted: the network's plan, if it
    passes its check; the exact MPC's plan; the rest of the last plan, if the MPC is late or has no solution; the last
    command, if the estimate is NaN or older than stale_after; inputs at rest, if nothing sound came for zero_after.
    Without supervision the network or the exact MPC is the first layer. References are clamped to the rig's travel.
    Before the first one the outputs are held where they were found; in lockstep an estimate waits for a reference that
    covers its preview. The guard judges estimate, actuators and state before that, and slows the loop down, holds or
    rests it; coming back, the reference begins where the rig is. joint_command needs somebody who publishes estimates.

    Services: stop brings the inputs to rest within stop_seconds and leaves them there, hold holds the outputs where
    they are, enable drives again, reset begins a new experiment, arm lets a loop move whose checks pass, disarm takes
    that back, estop, or true on the topic estop, rests it at once until it is reset and armed.
    """

    NAME = "controller"
    PUBLISHES = ("joint_command", "effort_command", "predicted_trajectory")
    SUBSCRIBES = ("state_estimate", "reference", "estop")
    adapter: ControllerAdapter

    def configure(self) -> None:
        self.lockstep: bool = self.settings["lockstep"]
        self.operation = Operation(armed=self.settings["armed"], tell=announce)
        self.use(self.adapter_of(self.settings))

    def adapter_of(self, settings: Mapping[str, Any]) -> ControllerAdapter:
        """The controller that the parameters name."""
        return ControllerAdapter(self.rig, settings, self.signature, self.get_logger().warning)

    def use(self, adapter: ControllerAdapter) -> None:
        """Answer with an adapter from now on."""
        if self.active:
            adapter.guard.go_on(self.adapter.guard)
        self.adapter, self.sources = adapter, adapter.sources

    def prepare(self, settings: Mapping[str, Any], names: frozenset[str]) -> Callable[[], object]:
        if names <= TIMES:
            return super().prepare(settings, names)
        adapter = self.adapter_of(settings)
        adapter.check_changed(names)
        return partial(self.use, adapter)

    def activate(self) -> None:
        self.layers, self.statuses = Counter[str](), Counter[str]()
        self.clipped = self.ended = self.repeated = self.doubts = 0
        self.execution, self.age = Timing(), Timing()
        self.output = CommandOutput(self.open("effort_command"), self.open("predicted_trajectory"))
        self.operation.begin()
        self.forget()
        self.entry, self.wishes = self.validator("state_estimate"), self.validator("reference")
        source = self.adapter.estimates
        needed = [source.listen(self) if source else self.listen(self.entry, "state_estimate", self.on_estimate)]
        references = self.listen(self.wishes, "reference", self.on_reference)
        self.listen(self.validator("estop"), "estop", self.on_estop)
        needed += [references] if self.lockstep else []
        patience = 0 if self.lockstep else monotonic_ns() + REFERENCE_PATIENCE  # the first step of a run is a step, too

        def expected() -> bool:
            return all(x.publishers() for x in needed) and (references.publishers() > 0 or monotonic_ns() > patience)

        self.when(expected, self.advertise)
        if not self.lockstep:
            self.every(WATCH_PERIOD, self.watch)

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        modes = {"enable": ControllerMode.DRIVE, "hold": ControllerMode.HOLD, "stop": ControllerMode.STOP}
        return {
            **{name: partial(self.turn_to, mode) for name, mode in modes.items()},
            "reset": self.reset,
            "arm": lambda: self.operation.arm(unready(self)),
            "disarm": lambda: self.operation.disarm(),
            "estop": partial(self.emergency_stop, "the service estop or a stop by hand"),
        }

    def forget(self) -> None:
        """Begin a new experiment."""
        self.adapter.begin()
        self.stamp = self.sound = self.shown = self.answered = self.acted = 0
        self.settled, self.returning = False, not self.operation.armed
        self.home = np.zeros(len(self.adapter.outputs))
        self.input = self.adapter.rest.copy()
        self.preview: Preview | None = None
        self.waiting: JointStates | None = None
        self.output.command = None

    def reset(self) -> None:
        """Begin a new experiment, and unlatch an emergency stop."""
        self.operation.reset()
        self.forget()

    def turn_to(self, mode: ControllerMode) -> None:
        """Drive, hold the outputs where they are now, or bring the inputs to rest and leave them there."""
        before = self.operation.mode
        self.operation.turn_to(mode)
        if before is ControllerMode.HOLD and mode is ControllerMode.DRIVE and self.settled:
            self.adapter.guard.lead_from(self.home)
        self.settled = self.settled and mode is ControllerMode.DRIVE

    def on_estop(self, message: Bool) -> None:
        """Stop at once; a false message ends nothing."""
        if message.data:
            self.emergency_stop("the topic estop")

    def emergency_stop(self, why: str) -> None:
        """Rest at once and stay there."""
        self.operation.emergency_stop(why)
        self.send(self.adapter.at_rest(), limited=False)

    def wind_down(self) -> None:
        """Stop, and give the inputs the time to come to rest."""
        self.operation.mode = ControllerMode.STOP
        announce("at rest")
        end = perf_counter() + self.settings["stop_seconds"] + WATCH_PERIOD
        while self.thread not in (None, get_ident()) and self.moves() and perf_counter() < end:
            sleep(WATCH_PERIOD / 10)

    def advertise(self) -> None:
        self.output.commands = self.open("joint_command")

    def on_reference(self, message: TrajectoryMessage) -> None:
        """Keep the newest reference."""
        if not self.wishes.accepts_source(message.source):
            return
        now = self.stamp if self.lockstep else self.now()
        preview = Preview.of(message, self.wishes, self.adapter.outputs, self.adapter.tracked, now)
        if preview is None:
            return
        self.wishes.select_source(message.source)
        self.clipped += not preview.within(*self.rig.reach)
        self.preview = preview
        if self.waiting is not None:
            waiting, self.waiting = self.waiting, None
            self.proceed(waiting, waiting.stamp, perf_counter())

    def on_estimate(self, joints: JointStates) -> None:
        """Answer an estimate."""
        began = perf_counter()
        given = self.entry.read(joints, self.adapter.estimated)
        if given is None or (order := self.entry.admit(joints)) is None:
            return
        if order is StampOrder.DUPLICATE or order is StampOrder.LATE:
            self.repeated += 1
            self.output.repeat()
            return
        if order is StampOrder.RESTART:
            self.forget()
        self.adapter.given[:] = given
        self.proceed(joints, joints.stamp if self.lockstep else self.now(), began)

    def proceed(self, joints: JointStates, now: int, began: float) -> None:
        """Answer an estimate that is believed and read; now: in the ROS clock [ns], began: when it came [s]."""
        stamp = joints.stamp
        last = stamp + self.adapter.ahead + int(self.adapter.grid[-1])
        if self.lockstep and (self.preview is None or not self.preview.covers(last)):
            self.wait(joints, last - stamp)
            return
        plan = self.answer(joints, (now - stamp) / SECOND, began)
        if plan is not None and stamp - self.shown >= SHOW_PERIOD * SECOND:
            self.shown = stamp
            self.output.show(self.adapter.plans, plan, stamp + self.adapter.ahead)

    def wait(self, joints: JointStates, reach: int) -> None:
        """In lockstep: keep an estimate until the reference reaches far enough [ns]."""
        if self.preview is not None and self.preview.times[-1] - self.preview.times[0] < reach:
            self.get_logger().warning(
                f"the reference does not reach {reach / SECOND:g} s ahead: raise its preview_seconds", once=True
            )
        self.waiting = joints

    def answer(self, joints: JointStates, age: float, began: float) -> MpcSolution | None:
        """Publish the command for an estimate of an age [s]; return the plan behind it, if there is one."""
        elapsed = (joints.stamp - self.stamp) / SECOND if self.stamp else 0.0
        self.stamp = stamp = joints.stamp
        self.age.add(max(age, 0.0))
        level = self.adapter.judge(joints, elapsed)
        state = self.operation.state(level)
        if state >= LoopState.STOPPED:
            self.stop()
            return None
        if not (np.isfinite(self.adapter.given).all() and self.settle(joints)) or age > self.settings["stale_after"]:
            self.hold()
            return None
        if level is LoopState.RESTING:
            self.rest(RESTED)
            return None
        if self.adapter.followed.names and (parameters := self.entry.read(joints, self.adapter.followed)) is not None:
            self.adapter.adapt(parameters)
        preview = self.reference(joints, level, elapsed)
        adapter, guard = self.adapter, self.adapter.guard
        plan = adapter.controller.control(adapter.state, adapter.disturbance, guard.turned(self.input), preview)
        layer = LAYERS[plan.status]
        self.statuses[plan.status.value] += 1
        if layer not in STANDING_IN:
            self.sound = self.time()
        elif self.is_long():
            self.rest(ZEROED)
            return None
        self.operation.become(state)
        self.layers[layer] += 1
        command = guard.slowed(plan.input, adapter.at_rest()) if guard.slows else plan.input
        taken = perf_counter() - began
        self.send(command)
        self.execution.add(taken)
        adapter.controller.prepare((stamp - self.answered) / SECOND if self.answered else 0.0)
        self.answered = stamp
        return plan

    def settle(self, joints: JointStates) -> bool:
        """Remember where the outputs were found, where a reference begins after rest; whether they were numbers."""
        if not self.settled:
            found = self.entry.read(joints, self.adapter.outputs)
            self.home[:] = math.nan if found is None else found
            self.home[~self.adapter.tracked] = 0.0
            self.settled = bool(np.isfinite(self.home).all())
            if self.settled and self.returning:
                self.returning = False
                self.adapter.controller.reset()
                self.adapter.guard.come_back(self.home)
        return self.settled

    def reference(self, joints: JointStates, level: LoopState, elapsed: float) -> Array:
        """Reference for the preview of an estimate (horizon, outputs), as the guard lets it pass."""
        stamp = joints.stamp
        holding = self.operation.mode is ControllerMode.HOLD
        if not holding and self.preview is None:
            self.layers[NO_REFERENCE] += 1
        if holding or self.preview is None:
            return np.tile(self.home, (len(self.adapter.grid), 1))
        if not self.preview.covers(stamp):  # the next one begins where this one has ended
            self.ended += 1
            self.adapter.guard.lead_from(last := self.preview.values[-1])
            return np.tile(last, (len(self.adapter.grid), 1))
        ahead = stamp + self.adapter.ahead
        preview, guard = self.preview.at(ahead + self.adapter.grid), self.adapter.guard
        if level is LoopState.DRIVING and guard.is_free:
            return preview
        now, found = self.preview.at(np.array([ahead]))[0], self.entry.read(joints, self.adapter.outputs)
        outputs = np.full(len(now), math.nan) if found is None else np.array(found)
        return guard.reference(level, now, outputs, preview, self.adapter.times, elapsed)

    def time(self) -> int:
        """Time that no clock can set [ns]; in lockstep that of the estimates."""
        return self.stamp if self.lockstep else monotonic_ns()

    def is_long(self) -> bool:
        """Whether there has been no sound answer for zero_after."""
        return not self.sound or self.time() - self.sound > self.settings["zero_after"] * SECOND

    def hold(self) -> None:
        """Without a sound estimate: the last command, and inputs at rest when that has lasted too long."""
        if self.is_long():
            self.rest(ZEROED)
            return
        self.layers[HELD] += 1
        self.send(self.adapter.guard.turned(self.input))

    def rest(self, layer: str) -> None:
        """Inputs at rest; from there the loop comes back gently."""
        self.layers[layer] += 1
        self.settled, self.returning = False, True
        self.operation.become(self.operation.state(LoopState.RESTING))
        self.send(self.adapter.at_rest() if layer == RESTED else self.adapter.rest)

    def stop(self) -> None:
        """Move the inputs nearer to rest, so that they get there within stop_seconds, or at once in an emergency."""
        now, seconds = self.time(), self.settings["stop_seconds"] * SECOND
        share = min((now - self.acted) / seconds, 1.0) if seconds and not self.operation.emergency else 1.0
        self.layers[STOPPED] += 1
        self.operation.become(self.operation.state(LoopState.RESTING))
        self.settled, self.returning = False, True
        self.send(self.adapter.nearer_rest(self.adapter.guard.turned(self.input), share))

    def watch(self) -> None:
        """Let the inputs rest when estimates stop: not every drive has a timeout of its own. See who wants numbers."""
        self.output.look()
        if self.moves() and self.time() - self.acted > self.settings["zero_after"] * SECOND:
            self.rest(ZEROED)

    def moves(self) -> bool:
        """Whether the newest command is not at rest."""
        return bool((self.input != self.adapter.rest).any())

    def deactivate(self) -> None:
        """Leave the inputs at rest."""
        if self.moves():
            self.send(self.adapter.rest, limited=False)

    def send(self, inputs: Array, *, limited: bool = True) -> None:
        """Publish a command for inputs (m,) that are to act; limited: no faster than the actuators can follow."""
        now, guard = self.time(), self.adapter.guard
        elapsed = (now - self.acted) / SECOND if self.acted else min(self.adapter.controller.period, LONGEST)
        acting = guard.followed(inputs, guard.turned(self.input), elapsed) if limited else inputs
        self.acted = now
        guard.commanded(acting)
        self.input[:] = guard.turned(acting)
        self.output.publish(self.adapter.writer.pack(self.stamp, self.input.tolist()), self.input)

    def health(self) -> Sequence[Task]:
        return [*loop_tasks(self), *(self.adapter.estimates.tasks() if self.adapter.estimates else ())]


main = partial(run, ControllerNode)

if __name__ == "__main__":
    sys.exit(main())
