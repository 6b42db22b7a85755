"""Stage: the nodes of a loop as processes, one who disturbs them, and one who watches."""

from __future__ import annotations

import math
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from benchmarks.faults import disk
from benchmarks.faults.disk import TROUBLE
from benchmarks.faults.observation import MOVING, PATIENCE, Observation
from hybrid_sysid_ros.control.safety.guarding import SMALL
from hybrid_sysid_ros.extensions.native.build import native_loop
from hybrid_sysid_ros.nodes import middleware, topics
from hybrid_sysid_ros.nodes.messages import nanoseconds, set_nanoseconds
from hybrid_sysid_ros.nodes.process import SWITCH_INTERVAL
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import TRAINED, defaults, settings, shipped
from hybrid_sysid_ros.runtime.processes import permitted_priority, priority_of
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Fault = Callable[["Stage"], None]
LOOP = ("reference", "estimator", "controller", "plant")
NODES = ("recorder", *LOOP)
SEEN, HEARD = "joint_states_seen", "joint_states"
"""What the plant publishes, and what the others hear: between them stands the :class:`Relay`."""
COMMANDED, ACTED = "joint_command", "joint_command_acted"
"""What the controller publishes, and what the plant hears where a fault stands between them."""
LASTING = 2.0
"""Of a fault that goes on [s]."""


ORDINARY, NATIVE = "FAULTS_ORDINARY", "FAULTS_NATIVE"
"""Environment variables that ask for processes without real-time priority, and for the native loop."""
COMPILING = 300.0
"""For the first start of the nodes, which may have to compile [s]."""
CLOCK_PERIOD = 0.005
"""Of /clock [s]."""
DEVIATIONS = 3.0
"""Of a sensor's noise and rounding, within which a fault of its reading is hidden; one of an input is within the share
of its range below which a guard says nothing of a command."""


class Relay:
    """Passes joint messages on: as bytes, which takes next to no time, or as a fault makes them.

    shown: steady time of the first message in which a fault can be seen [s], inf while there is none, NaN without a
    fault: another stamp, another number of messages, or a number that is off by more than noise hides.
    """

    def __init__(
        self, node: Node, source: str, target: str, quality: str, see: Callable[[bytes], None],
        places: Sequence[SignalPlace], hidden: Array,
    ) -> None:  # fmt: skip
        """see: gets each message once it has been passed on, as it came. quality: topic whose quality both have.
        places, hidden: numbers of a message, and by how much each may be off unseen.
        """
        self.change: Callable[[JointState], Sequence[JointState]] | None = None
        self.shown = math.nan
        self._slots, self._hidden = Slots(places), np.append(0.0, hidden)
        self._node, self._see, self._target, self._quality = node, see, target, topics.profile(quality)
        self.publisher = self.new_publisher()
        node.create_subscription(JointState, source, self.on_message, self._quality, raw=True)

    def new_publisher(self) -> Publisher:
        """As the first one's own."""
        return self._node.create_publisher(JointState, self._target, self._quality)

    def on_message(self, data: bytes) -> None:
        """Pass on what is left of it."""
        if (change := self.change) is None:
            self.publisher.publish(data)
        else:
            message = deserialize_message(data, JointState)
            before = self._numbers(message)
            sent = [*change(message)]
            for each in sent:
                self.publisher.publish(each)
            if not math.isfinite(self.shown):
                is_hidden = len(sent) == 1 and self._alike(before, self._numbers(sent[0]))
                self.shown = math.inf if is_hidden else time.monotonic()
        self._see(data)

    def _alike(self, before: Array, after: Array) -> bool:
        return np.array_equal(np.isnan(before), np.isnan(after)) and not (np.abs(after - before) > self._hidden).any()

    def _numbers(self, message: JointState) -> Array:
        """Its stamp [ns], and the numbers in their places."""
        lists = [message.position, message.velocity, message.effort]
        return np.array([nanoseconds(message.header.stamp), *self._slots.read(list(message.name), lists)])


class SetClock:
    """Publishes /clock: the system's time, moved by ``offset`` [ns], or standing still."""

    def __init__(self, node: Node) -> None:
        self.offset, self.stands = 0, False
        self._publisher = node.create_publisher(Clock, "/clock", 1)
        node.create_timer(CLOCK_PERIOD, self.on_timer)

    def on_timer(self) -> None:
        """Tell the time."""
        if not self.stands:
            message = Clock()
            set_nanoseconds(message.clock, time.time_ns() + self.offset)
            self._publisher.publish(message)


class Stage(Observation):
    """The loop of a rig that follows a moving reference, and what is seen of it, as a context."""

    def __init__(self, rig: Rig, *, domain: int, clocked: bool = False, actuated: bool = False) -> None:
        """clocked: its time is that of /clock. actuated: commands pass a relay, for faults of actuators."""
        super().__init__(rig)
        self.native = bool(os.environ.get(NATIVE))
        self.nodes: tuple[str, ...] = NODES
        if self.native:
            self.nodes = tuple("native" if name == "estimator" else name for name in NODES if name != "controller")
        self.domain, self.priority = domain, 0 if os.environ.get(ORDINARY) else permitted_priority()
        self.joint = next(iter(rig.joints.joints))
        self.clocked, self.actuated = clocked, actuated
        self.lines: list[str] = []
        """What nodes have printed: a traceback would be among them."""
        self.started = 0.0
        """Steady time at which a fault begins; one that must prepare something moves it [s]."""
        self._bags = 0

    def __enter__(self) -> Stage:
        self._temporary = TemporaryDirectory()
        self.folder = Path(self._temporary.name)
        self.model, self.policy = (self._copied(self.rig.name, kind) for kind in ("model", "policy"))
        self.other_model = (
            next(folder for folder in sorted(TRAINED.iterdir()) if folder.name != self.rig.name) / "model"
        )
        self.disk = self.folder / "disk"
        self.disk.write_text("")
        os.environ[TROUBLE] = str(self.disk)
        self.session = Session(self.rig.source, domain=self.domain, tell=self.lines.append)
        self.context = Context()
        middleware.prepare_middleware()
        rclpy.init(context=self.context, domain_id=self.domain)
        options = {"start_parameter_services": False, "enable_rosout": False}  # each would cost the relay time
        self.node = Node("saboteur", context=self.context, namespace=self.rig.namespace, **options)
        noise = np.array([abs(sensor.scale) * sensor.floor for sensor in self.rig.sensors])
        tolerance = defaults(self.rig, "controller")["actuator_tolerance"] * np.subtract(*self.rig.limits[::-1])
        heard = [*self.outputs, *self.inputs], np.concatenate([DEVIATIONS * noise, SMALL * tolerance])
        self.relay = Relay(self.node, SEEN, HEARD, HEARD, self._see, *heard)
        self.relays = [self.relay]
        if self.actuated:
            acted = self.inputs, SMALL * tolerance
            self.actuators = Relay(self.node, COMMANDED, ACTED, COMMANDED, lambda data: None, *acted)
            self.relays.append(self.actuators)
        self.node.create_subscription(JointTrajectory, "reference", self._refer, topics.profile("reference"), raw=True)
        if self.clocked:
            self.clock = SetClock(self.node)
        heard = topics.profile("joint_command")
        self.node.create_subscription(JointState, "joint_command", self._hear, heard, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, topics.profile("/diagnostics"))
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        sys.setswitchinterval(SWITCH_INTERVAL)  # who disturbs must not hold up the relay
        self.thread = Thread(target=self._spin, daemon=True)
        self.thread.start()
        try:
            for name in self.nodes:
                self.start(name)
            self.session.wait_for("ready", self.nodes, COMPILING)
            self.wait_until_back(time.monotonic())
            self.learn()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.session.stop()
        self.executor.shutdown()
        self.context.try_shutdown()
        self.thread.join()
        self._temporary.cleanup()

    def _copied(self, rig: str, kind: str) -> Path:
        """A copy of what comes with the package, for a fault to spoil."""
        return Path(shutil.copytree(shipped(rig, kind), self.folder / kind))

    def _spin(self) -> None:
        # The relay stands in the loop, with the middleware's threads; the main one does not, nor writers of large
        # messages, which have spun at this priority for ever and starved the loop.
        threads = {int(name) for name in os.listdir("/proc/self/task")} - {os.getpid()} if self.priority else set[int]()
        for thread in threads:
            if Path(f"/proc/self/task/{thread}/comm").read_text().startswith("dds.asyn"):
                continue
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(self.priority))
        while self.context.ok():
            with suppress(Exception):  # a publisher is destroyed, or the context ends, while it spins
                self.executor.spin_once(timeout_sec=0.1)

    @property
    def bag(self) -> Path:
        """The newest one."""
        return self.folder / f"bag_{self._bags}"

    @property
    def recorded(self) -> int:
        """Messages that the recorder has said to be on the disk."""
        return int(self.values["recorder"]["kept"])

    def start(self, name: str, *, rig: Path | None = None, use_sim_time: bool = False, **more: Any) -> None:
        """Start a node's process; rig: another one of the same name."""
        if name == "native":
            self.start_native()
            return
        self._bags += name == "recorder"
        values: dict[str, dict[str, Any]] = {
            "reference": dict(MOVING[self.rig.name]),
            "estimator": {"model": str(self.model)},
            "controller": {
                "policy": "supervised",
                "certificate": "ignore",
                "model": str(self.model),
                "policy_path": str(self.policy),
            },
            "plant": {"wait_for_readers": 1},
            "recorder": {"path": str(self.bag)},
        }
        priority = {"priority": priority_of(name, self.priority)}
        session = Session(str(rig), domain=self.domain) if rig else self.session
        command = session.command(name, {**values[name], **priority, **more})
        if name == "plant":
            command += ["-r", f"joint_states:={SEEN}"]
            command += ["-r", f"{COMMANDED}:={ACTED}"] if self.actuated else []
        if name == "recorder":
            command[command.index("hybrid_sysid_ros.nodes.recorder")] = disk.__name__
        if self.clocked or use_sim_time:
            command += ["-p", "use_sim_time:=true"]
        self.session.start(name, command)

    def start_native(self) -> None:
        """Start estimator and controller as one process in C."""
        given: dict[str, dict[str, Any]] = {"estimator": {}, "controller": {"policy": "supervised"}}
        every = {node: settings(self.rig, node, own)[0] or {} for node, own in given.items()}
        own = {node: {"priority": priority_of(node, self.priority)} for node in given}
        arguments = self.session.arguments(own) + (["-p", "use_sim_time:=true"] if self.clocked else [])
        self.session.start("native", [str(native_loop(self.rig, every, tell=self.lines.append)), *arguments])

    def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """Send a node's process a signal. Raises UserError where it has none of its own."""
        if name not in self.session.children:
            raise UserError(f"the native loop has no process {name}: this fault is one of the Python nodes")
        self.session.children[name].process.send_signal(number)

    def end(self, name: str) -> None:
        """End a node as an operator does, and wait for it."""
        self.kill(name, signal.SIGTERM)
        self.session.children[name].process.wait()

    def restart(self, name: str) -> None:
        """Start a node again that was killed, and wait until it is ready."""
        self.session.children[name].process.wait()
        self.start(name)
        self.session.wait_for("ready", [name], PATIENCE)

    def publisher(self, topic: str, *, reliable: bool = True) -> Publisher:
        """A second publisher of one of the rig's topics, once somebody hears it, if that comes soon."""
        quality = topics.profile(topic)
        quality.reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        found = self.node.create_publisher(topics.TYPES[topic], topic, quality)
        end = time.monotonic() + 5.0
        while not found.get_subscription_count() and time.monotonic() < end:
            time.sleep(0.01)
        return found

    def calm(self, least: float) -> None:
        """Wait until no diagnostics have reported anything for so long [s]; at most for PATIENCE."""
        begin = time.monotonic()
        while (now := time.monotonic()) < begin + PATIENCE:
            if now > begin + least and not any(said.time > now - least for said in self.said[-50:]):
                return
            time.sleep(0.05)

    def memory(self) -> dict[int, float]:
        """Resident memory of each process [MB]."""
        found = {}
        for child in self.session.children.values():
            with suppress(OSError):
                pages = int(Path(f"/proc/{child.process.pid}/statm").read_text().split()[1])
                found[child.process.pid] = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        return found

    def alive(self) -> None:
        """Raises UserError where a node has ended by itself."""
        for name, child in self.session.children.items():
            if child.process.poll() is not None:
                raise UserError(f"{name} has ended: {child.complaint}")
