"""Plant: the simulated rig with the topics of a real one."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from random import Random
from time import perf_counter

from rclpy.timer import Timer

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.drive import Answers, Drive
from hybrid_sysid_ros.nodes.joint_motion import JointMotion
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates
from hybrid_sysid_ros.nodes.plant_health import loop_task
from hybrid_sysid_ros.nodes.process import announce, run
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.nodes.stop_by_hand import StopByHand
from hybrid_sysid_ros.nodes.timing import Timeline, Timing
from hybrid_sysid_ros.rigs.joints import FILTERED
from hybrid_sysid_ros.rigs.plant import Plant

LOCKSTEP_START = SECOND  # stamp of the first measurement: 0 means "no time yet" to ROS
EARLY = 0.1  # periods that a timer may be early; late ones never reach into the next period
START_DELAY = 0.5  # s from the discovery of all peers to the start, since they may not know each other yet
READER_PATIENCE = 0.5  # s, with further readers where there is a loop
CAMERA_PATIENCE = 0.5  # s, with a camera that does not show the rig
ANSWER_TIMEOUT = 5.0  # s, after which an unanswered measurement is published again


class PlantNode(RigNode):
    """Publishes measurement k at start + k / rate and integrates the rig in between.

    In real time a command acts from the moment it comes (to the rig's next step); in lockstep the command that answers
    a measurement acts from that measurement's stamp on, and the next one follows at once.

    Inputs at rest from another publisher than the controller are a stop by hand: the plant asks the controller to stop
    too, and ignores commands until it has, or until its own service enable or reset is called.
    """

    NAME = "plant"
    PUBLISHES = ("joint_states", "motion")
    SUBSCRIBES = ("joint_command", "camera/joint_states")

    def configure(self) -> None:
        settings, rig = self.settings, self.rig
        self.steps = rig.steps(1.0 / settings["rate"], f"parameter rate is {settings['rate']:g} Hz: its period")
        self.lockstep: bool = settings["lockstep"]
        self.plant = Plant(rig, seed=settings["seed"], bias=settings["bias"])
        self.plant.advance([actuator.rest for actuator in rig.actuators])  # compiles
        layout = SignalLayout(rig, rig.system)
        self.low_passed = [k for k, sensor in enumerate(rig.sensors) if sensor.low_pass]
        filtered = [layout.outputs[k].ending(f"_{FILTERED}") for k in self.low_passed]
        self.writer = JointWriter(Slots([*layout.outputs, *layout.inputs, *filtered]), self.signature)
        self.inputs = Slots(layout.inputs)
        self.rest = [actuator.rest for actuator in rig.actuators]
        self.lateness = Timing()
        self.rejected = self.overruns = self.repeated = self.stops = self.direct = 0
        self.begin()

    def begin(self) -> None:
        """Set the rig to its initial state, at time 0."""
        self.plant = Plant(self.rig, seed=self.settings["seed"], bias=self.settings["bias"])
        self.chance = Random(self.settings["seed"])
        self.motion = JointMotion(self.rig, self.steps, self.signature)
        self.answers = Answers(start=LOCKSTEP_START, period=round(self.steps * self.rig.step * SECOND))
        self.rested()
        self.hand.release()
        self.started = self.controlled = False

    def rested(self) -> None:
        """Put the inputs to rest, and drop delayed ones."""
        timeout = math.inf if self.lockstep else self.settings["command_timeout"]
        self.drive = Drive(self.rig.actuators, timeout=timeout)

    def activate(self) -> None:
        """Wait for a loop, and start the rig from its present state."""
        self.timeline = Timeline(self.now)
        self.alone = perf_counter()  # when somebody was missing last without whom there is no loop [s]
        self.ticks: Timer | None = None
        self.measurements = self.open("joint_states")
        self.motions = self.open("motion")
        self.entry = self.validator("joint_command")
        self.commands = self.listen(self.entry, "joint_command", self.on_command)
        self.frame = -1
        """Stamp of the newest frame that was read [ns]."""
        self.frames = None
        if self.settings["camera_rate"]:
            self.frames = self.listen(self.validator("camera/joint_states"), "camera/joint_states", self.on_frame)
        self.when(self.is_matched, self.wait)

    @cached_property
    def hand(self) -> StopByHand:
        """Stops by other publishers than the controller."""
        return StopByHand(self)

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        return {"reset": self.reset, "enable": self.hand.release}

    def reset(self) -> None:
        """Start the rig again from its initial state, in real time without a pause."""
        if self.lockstep or self.frames is not None or not self.started:  # others wait for its measurements
            self.soon(self.again)
        else:
            self.begin()
            self.start()

    def again(self) -> None:
        self._leave()
        self.begin()
        self.activate()
        self.active = True

    def deactivate(self) -> None:
        """Stop the rig's time with the inputs at rest."""
        self.rested()
        self.started = False

    def is_matched(self) -> bool:
        """Whether those are there that the plant waits for; in real time, a controller, a camera and some readers for
        READER_PATIENCE: a plant that is started again finds a loop whose reference needs no measurements any more.
        """
        readers, found = self.settings["wait_for_readers"], self.measurements.get_subscription_count()
        if readers == 0 and not self.lockstep:
            return True
        now = perf_counter()
        blind = self.frames is not None and not self.frames.publishers()
        if blind or found < min(readers, 1) or not self.commands.publishers():
            self.alone = now
            return False
        return found >= readers or (not self.lockstep and now - self.alone > READER_PATIENCE)

    def wait(self) -> None:
        """Start the rig after peers have had time to discover it, so that a bag does not begin later."""
        matched = perf_counter()
        shown = self.frames is not None and not self.lockstep
        self.when(lambda: perf_counter() - matched >= START_DELAY, self.show if shown else self.start)

    def show(self) -> None:
        """Show the rig's position to a camera, so that a loop with the camera alone knows it from the beginning; in
        lockstep the first measurement waits for that.
        """
        self.frame, shown = -1, perf_counter()
        self.motions.publish(self.motion.message(self.now()))
        self.when(lambda: self.frame >= 0 or perf_counter() - shown > CAMERA_PATIENCE, self.start)

    def start(self) -> None:
        """Start the rig."""
        self.started = True
        announce("started")
        self.timeline.begin(self.now() - round(self.plant.time * SECOND))
        if self.lockstep:
            self.every(ANSWER_TIMEOUT / 5, self.ask_again)
        else:
            self.answers.start = self.timeline.start
            if self.ticks is None:
                self.ticks = self.every(self.answers.period / SECOND, self.tick)
        if self.answers.latest < 0:
            self.measure(0, self.drive.at(0.0))
        elif self.lockstep:
            self.publish()

    def tick(self) -> None:
        """In real time: integrate up to now and publish the measurement that is due. Those that were missed are left
        out, as by a real driver: a burst of them would be answered late, one after the other.
        """
        elapsed = self.timeline.follow() / SECOND
        self.answers.start = self.timeline.start
        period = self.answers.period / SECOND
        number = int(elapsed / period + EARLY)
        due = number - self.answers.latest
        self.overruns += max(due - 1, 0)
        self.lateness.add(max(elapsed - number * period, 0.0))
        self.disturb()
        self.drive.timeout = self.settings["command_timeout"]
        if due > 0 and not self.finished.done():
            self.measure(number, self.integrate(due * self.steps))

    def disturb(self) -> None:
        """Apply the faults of the parameters."""
        self.plant.bias[:] = self.settings["bias"]
        self.plant.brake[:] = self.settings["brake"]

    @property
    def time(self) -> float:
        """Steady time since the start [s]."""
        return self.timeline.elapsed() / SECOND

    def integrate(self, steps: int) -> list[float]:
        """Advance the rig; return the mean applied inputs, (m,)."""
        total = [0.0] * len(self.inputs)
        for _ in range(steps):
            self.plant.advance(self.drive.at(self.plant.time))
            self.motion.see(self.plant)
            total = [one + other for one, other in zip(total, self.plant.applied, strict=True)]
        return [value / steps for value in total]

    def measure(self, number: int, applied: Sequence[float]) -> None:
        """Publish measurement `number`, with the mean inputs (m,) since the one before."""
        self.answers.measured(number, self.time)
        measurement = self.plant.measure()
        filtered = measurement.filtered[self.low_passed].tolist()
        lost = [self.chance.random() < share if share else False for share in self.settings["sensor_out"]]
        outputs = [math.nan if out else value for value, out in zip(measurement.outputs.tolist(), lost, strict=True)]
        filtered = [math.nan if lost[k] else value for k, value in zip(self.low_passed, filtered, strict=True)]
        values = [*outputs, *applied, *filtered]
        stamp = self.answers.stamp(number)
        motion = self.motion.message(stamp)
        if self.motions.get_subscription_count():
            self.motions.publish(motion)
        self.measurement = self.writer.pack(stamp, values)
        self.publish()
        if 0.0 < self.settings["duration"] <= self.plant.time:
            self.finish()

    def publish(self) -> None:
        """Publish the newest measurement."""
        self.asked = perf_counter()
        self.measurements.publish(self.measurement)

    def on_command(self, joints: JointStates) -> None:
        """Apply a command if it is a stop, an answer to a measurement, or one that :meth:`is_direct`."""
        if not self.started:
            return
        time, stamp = self.time, joints.stamp
        inputs = self.entry.read(joints, self.inputs)
        if inputs is None or not all(map(math.isfinite, inputs)):
            return
        resting = inputs == self.rest
        if resting and self.is_by_hand(joints):
            self.stops += 1
            if self.controlled:
                self.hand.stop(self.answers)
            self.obey(inputs)
            return
        if not self.entry.accepts_source(joints.source):
            return
        if resting and not self.lockstep and not self.answers.awaits(stamp):
            self.stops += 1
        elif self.answers.answer(stamp, time):
            self.controlled = True
        elif self.is_direct(stamp, time):
            self.direct += 1
            self.controlled = False
        else:
            self.rejected += 1
            return
        self.entry.select_source(joints.source)
        if self.hand.holds(self.answers) and not resting:
            self.hand.disobeyed += 1
        else:
            self.obey(inputs)
        self.go_on()

    def obey(self, inputs: Sequence[float]) -> None:
        """Apply a command."""
        self.drive.command(inputs, (self.plant.time if self.lockstep else self.time) + self.settings["command_delay"])

    def is_by_hand(self, joints: JointStates) -> bool:
        """Whether another publisher than the controller, which uses stamps of measurements, commands inputs at rest."""
        known = self.answers.measurement(joints.stamp) is not None
        return not known and (not joints.stamp or joints.source != self.entry.source)

    def go_on(self) -> None:
        """In lockstep: advance to the next measurement, if this one is answered and all due frames are read."""
        if not self.lockstep or self.answers.answered != self.answers.latest:
            return
        following = self.answers.latest + 1
        if self.settings["camera_rate"] and self.frame < self.due(self.answers.stamp(following)):
            return
        self.disturb()
        self.measure(following, self.integrate(self.steps))

    def due(self, stamp: int) -> int:
        """Stamp of the newest frame that must have been read by then [ns], less half a period, as a frame's reading may
        be stamped by another row than its middle.
        """
        period = SECOND / self.settings["camera_rate"]
        newest = stamp - round(self.settings["camera_latency"] * SECOND)
        due = round(LOCKSTEP_START + ((newest - LOCKSTEP_START) // period - 0.5) * period)
        return due if newest >= LOCKSTEP_START else -1

    def on_frame(self, joints: JointStates) -> None:
        """Note that a frame was read."""
        self.frame = max(self.frame, joints.stamp)
        if self.started:
            self.go_on()

    def is_direct(self, stamp: int, time: float) -> bool:
        """Whether a command that answers no measurement counts: one of a person or of another driver, stamped with the
        time of now or not at all, while no controller has answered for ``silence``. Not in lockstep.
        """
        if self.lockstep or time - self.answers.last < self.settings["silence"]:
            return False
        return stamp == 0 or (self.answers.measurement(stamp) is None and self.entry.is_near(stamp))

    def ask_again(self) -> None:
        """In lockstep: repeat a measurement that is not answered."""
        waiting = perf_counter() - self.asked
        if waiting > ANSWER_TIMEOUT:
            self.repeated += 1
            self.get_logger().warning(
                f"no command for measurement {self.answers.latest} in {waiting:.1f} s "
                f"({self.rejected} commands rejected so far): published again"
            )
            self.publish()

    def health(self) -> Sequence[Task]:
        return [loop_task(self)]


main = partial(run, PlantNode)

if __name__ == "__main__":
    sys.exit(main())
