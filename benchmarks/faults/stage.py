"""Stage: the nodes of a loop as processes, one who disturbs them, and one who watches."""

from __future__ import annotations

import math
import os
import shutil
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from benchmarks.faults import disk
from benchmarks.faults.disk import TROUBLE
from hybrid_sysid_ros.nodes import middleware, topics
from hybrid_sysid_ros.nodes.messages import set_nanoseconds
from hybrid_sysid_ros.nodes.process import SWITCH_INTERVAL
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import TRAINED, shipped
from hybrid_sysid_ros.runtime.processes import permitted_priority, priority_of
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError

Fault = Callable[["Stage"], None]
LOOP = ("reference", "estimator", "controller", "plant")
NODES = ("recorder", *LOOP)
SEEN, HEARD = "joint_states_seen", "joint_states"
"""What the plant publishes, and what the others hear: between them stands the :class:`Relay`."""
LASTING = 2.0
"""Of a fault that goes on [s]."""
SETTLED = 60
"""Measurements in a row that are answered in time: the loop is back."""
LATE = 0.004
"""By which an answer that came before the next measurement may be seen later than that [s]."""
INCOMPATIBLE = "somebody else"
"""frame_id of what the one who disturbs says: that is no command of the loop."""
REMEMBERED = 20_000
"""Measurements, and commands."""
PATIENCE = 30.0
"""Of all that is waited for [s]."""


CLOCK_PERIOD = 0.005
"""Of /clock [s]."""


@dataclass(frozen=True)
class Said:
    """A status of the diagnostics that was not OK."""

    time: float
    name: str
    level: int
    message: str


class Relay:
    """Passes measurements on: as bytes, which takes next to no time, or as a fault makes them."""

    def __init__(self, node: Node, see: Callable[[bytes], None]) -> None:
        """see: gets each measurement once it has been passed on."""
        self.change: Callable[[JointState], Sequence[JointState]] | None = None
        self._node, self._see = node, see
        self.publisher = self.new_publisher()
        node.create_subscription(JointState, SEEN, self.on_measurement, topics.profile(HEARD), raw=True)

    def new_publisher(self) -> Publisher:
        """As the plant's own."""
        return self._node.create_publisher(JointState, HEARD, topics.profile(HEARD))

    def on_measurement(self, data: bytes) -> None:
        """Pass on what is left of it."""
        change = self.change
        for each in [data] if change is None else change(deserialize_message(data, JointState)):
            self.publisher.publish(each)
        self._see(data)


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


class Stage:
    """The loop of a rig that holds its first reference, and what is seen of it, as a context."""

    def __init__(self, rig: Rig, *, domain: int, reference: str = "constant", clocked: bool = False) -> None:
        """clocked: its time is that of /clock."""
        self.rig, self.domain, self.priority = rig, domain, permitted_priority()
        self.joint = next(iter(rig.joints.joints))
        self.reference, self.clocked = reference, clocked
        self.lines: list[str] = []
        """What nodes have told: a traceback would be among them."""
        self.answered: dict[int, float] = {}
        """Steady time of the first command for each stamp [s]."""
        self.measured: deque[tuple[float, int, float, float]] = deque(maxlen=REMEMBERED)
        """Steady time, stamp, position and input of each measurement."""
        self.commands: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        """Steady time and effort of every command, but the stranger's."""
        self.started = 0.0
        """Steady time at which a fault begins; one that must prepare something moves it [s]."""
        self.said: list[Said] = []
        self.values: dict[str, dict[str, str]] = {}
        """Newest values in the diagnostics of each node."""
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
        self.validator = MessageValidator(JointState, steady=time.monotonic_ns)  # by which bytes are read at once
        self.relay = Relay(self.node, self._see)
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
        for name in NODES:
            self.start(name)
        self.session.wait_for("ready", NODES, PATIENCE)
        self.wait_until_back(time.monotonic())
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
        # The relay stands in the loop, with the middleware's threads; the main one does not.
        for thread in {int(name) for name in os.listdir("/proc/self/task")} - {os.getpid()} if self.priority else ():
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
        self._bags += name == "recorder"
        values: dict[str, dict[str, Any]] = {
            "reference": {"kind": self.reference},
            "estimator": {"model": str(self.model)},
            "controller": {"policy": "supervised", "model": str(self.model), "policy_path": str(self.policy)},
            "plant": {"wait_for_readers": 1},
            "recorder": {"path": str(self.bag)},
        }
        priority = {"priority": priority_of(name, self.priority)}
        session = Session(str(rig), domain=self.domain) if rig else self.session
        command = session.command(name, {**values[name], **priority, **more})
        if name == "plant":
            command += ["-r", f"joint_states:={SEEN}"]
        if name == "recorder":
            command[command.index("hybrid_sysid_ros.nodes.recorder")] = disk.__name__
        if self.clocked or use_sim_time:
            command += ["-p", "use_sim_time:=true"]
        self.session.start(name, command)

    def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """Send a node's process a signal."""
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
        """Wait until no diagnostics have told of anything for so long [s]; at most for PATIENCE."""
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

    # ------------------------------------------------------------------ what is seen

    def _see(self, data: bytes) -> None:
        now, joints = time.monotonic(), self.validator.unpack(data)
        if joints is None:
            return
        position, _, effort = joints.lists
        index = list(joints.names).index(self.joint)
        self.measured.append((now, joints.stamp, position[index], effort[index]))

    def _hear(self, data: bytes) -> None:
        now, joints = time.monotonic(), self.validator.unpack(data)
        if joints is None:
            return
        self.answered.setdefault(joints.stamp, now)
        if len(joints.lists[-1]) == 1 and joints.source != INCOMPATIBLE:
            self.commands.append((now, joints.lists[-1][0]))

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = status.name.partition(":")[0].rpartition("/")[2]
            self.values.setdefault(node, {}).update({value.key: value.value for value in status.values})
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            if level != int.from_bytes(DiagnosticStatus.OK, "little"):
                self.said.append(Said(time.monotonic(), status.name, level, status.message))

    def wait_until_back(self, since: float) -> float:
        """Time from ``since`` until the first of SETTLED measurements in a row that were answered before the next one;
        inf after PATIENCE [s].
        """
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            recent = [*takewhile(lambda entry: entry[0] >= since, reversed(self.measured.copy()))][:0:-1]
            first, run = since, 0
            for (moment, stamp, *_), (following, *_) in pairwise(recent):
                answer = self.answered.get(stamp)
                in_time = answer is not None and answer <= following + LATE
                first, run = (first if run else moment, run + 1) if in_time else (since, 0)
                if run == SETTLED:
                    return first - since
            time.sleep(0.05)
        return float("inf")

    def bounded(self, since: float) -> bool:
        """Whether all inputs since then were within the actuator's limits, applied or commanded."""
        actuator = self.rig.actuators[0]
        applied = [entry[3] for entry in self.measured.copy() if entry[0] >= since]
        commanded = [effort for moment, effort in self.commands.copy() if moment >= since and math.isfinite(effort)]
        values = np.array([*applied, *commanded])
        return bool(np.all((values >= actuator.low - 1e-9) & (values <= actuator.high + 1e-9)))

    def inside(self, since: float) -> bool:
        """Whether the rig was within its travel, its stops not touched, as its sensor shows it."""
        low, high = self.rig.travel_of_outputs[:, 0]
        positions = np.array([entry[2] for entry in self.measured.copy() if entry[0] >= since])
        return bool(np.all((positions > low) & (positions < high)))

    def alive(self) -> None:
        """Raises UserError where a node has ended by itself."""
        for name, child in self.session.children.items():
            if child.process.poll() is not None:
                raise UserError(f"{name} has ended: {child.complaint}")
