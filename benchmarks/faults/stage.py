"""Stage: plant, estimator, controller and reference as processes, one who disturbs them, and one who watches."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from threading import Thread
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.messages import nanoseconds
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.session import Session, permitted_priority
from hybrid_sysid_ros.support.errors import UserError

NODES = ("reference", "estimator", "controller", "plant")
SEEN, HEARD = "joint_states_seen", "joint_states"
"""What the plant publishes, and what the others hear: between them stands the :class:`Relay`."""
SETTLED = 60
"""Measurements in a row that are answered in time: the loop is back."""
PATIENCE = 30.0
"""Of all that is waited for [s]."""


@dataclass(frozen=True)
class Said:
    """A status of the diagnostics that was not OK."""

    time: float
    name: str
    level: int
    message: str


class Relay:
    """Passes measurements on, as they are or as a fault makes them."""

    def __init__(self, node: Node) -> None:
        self.change: Callable[[JointState], Sequence[JointState]] = lambda message: [message]
        self.publisher = node.create_publisher(JointState, HEARD, topics.profile(HEARD))
        node.create_subscription(JointState, SEEN, self.on_measurement, topics.profile(HEARD))

    def on_measurement(self, message: JointState) -> None:
        """Pass on what is left of it."""
        for each in self.change(message):
            self.publisher.publish(each)


class Stage:
    """The loop of a rig that holds its first reference, and what is seen of it, as a context."""

    def __init__(self, rig: Rig, *, domain: int, reference: str = "constant") -> None:
        self.rig, self.domain, self.priority = rig, domain, permitted_priority()
        self.joint = next(iter(rig.joints.joints))
        self.session = Session(rig.source, domain=domain, tell=lambda line: self.lines.append(line))
        self.lines: list[str] = []
        """What nodes have told: a traceback would be among them."""
        self.reference = reference
        self.context = Context()
        self.answered: dict[int, float] = {}
        """Steady time of the first command for each stamp [s]."""
        self.measured: list[tuple[float, int, float, float]] = []
        """Steady time, stamp, position and input of each measurement."""
        self.begun = 0.0
        """Steady time at which a fault begins; one that must prepare something moves it [s]."""
        self.said: list[Said] = []
        self.commands: list[tuple[float, float]] = []
        """Steady time and effort of every command."""

    def __enter__(self) -> Stage:
        rclpy.init(context=self.context, domain_id=self.domain)
        self.node = Node("saboteur", context=self.context, namespace=self.rig.namespace)
        self.relay = Relay(self.node)
        self.node.create_subscription(JointState, SEEN, self._see, topics.profile(HEARD))
        self.node.create_subscription(JointState, "joint_command", self._hear, topics.profile("joint_command"))
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, topics.profile("/diagnostics"))
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = Thread(target=self._spin, daemon=True)
        self.thread.start()
        for name in NODES:
            self.start(name)
        self.session.wait_for("ready", NODES, PATIENCE)
        self.wait_until_back(time.monotonic())
        return self

    def __exit__(self, *error: Any) -> None:
        self.session.stop()
        self.executor.shutdown()
        self.context.try_shutdown()
        self.thread.join()

    def _spin(self) -> None:
        if self.priority:  # the relay stands in the loop
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(self.priority))
        while self.context.ok():
            try:
                self.executor.spin_once(timeout_sec=0.1)
            except Exception:  # the context ends while it spins
                return

    def start(self, name: str, **more: Any) -> None:
        """Start a node's process."""
        values: dict[str, dict[str, Any]] = {
            "reference": {"kind": self.reference},
            "estimator": {},
            "controller": {"policy": "supervised"},
            "plant": {"wait_for_readers": 1},
        }
        priority = {} if name == "reference" else {"priority": self.priority}
        command = self.session.command(name, {**values[name], **priority, **more})
        if name == "plant":
            command += ["-r", f"joint_states:={SEEN}"]
        self.session.start(name, command)

    def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """Send a node's process a signal."""
        self.session.children[name].process.send_signal(number)

    def restart(self, name: str) -> None:
        """Start a node again that was killed, and wait until it is ready."""
        self.session.children[name].process.wait()
        self.start(name)
        self.session.wait_for("ready", [name], PATIENCE)

    def publisher(self, topic: str) -> Any:
        """A second publisher of one of the rig's topics, once somebody hears it."""
        found = self.node.create_publisher(topics.TYPES[topic], topic, topics.profile(topic))
        end = time.monotonic() + 5.0
        while not found.get_subscription_count() and time.monotonic() < end:
            time.sleep(0.01)
        return found

    # ------------------------------------------------------------------ what is seen

    def _see(self, message: JointState) -> None:
        index = list(message.name).index(self.joint)
        values = message.position[index], message.effort[index]
        self.measured.append((time.monotonic(), nanoseconds(message.header.stamp), *values))

    def _hear(self, message: JointState) -> None:
        now = time.monotonic()
        self.answered.setdefault(nanoseconds(message.header.stamp), now)
        if len(message.effort) == 1:
            self.commands.append((now, message.effort[0]))

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            if level != int.from_bytes(DiagnosticStatus.OK, "little"):
                self.said.append(Said(time.monotonic(), status.name, level, status.message))

    def wait_until_back(self, since: float) -> float:
        """Time from ``since`` until SETTLED measurements in a row were answered before the next one; inf after
        PATIENCE.
        """
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            recent = [entry for entry in list(self.measured) if entry[0] >= since][:-1]
            run = 0
            for (moment, stamp, *_), (following, *_) in pairwise(recent):
                answer = self.answered.get(stamp)
                run = run + 1 if answer is not None and answer <= following + 0.004 else 0
                if run == SETTLED:
                    return moment - since - (SETTLED - 1) * (recent[1][0] - recent[0][0])
            time.sleep(0.05)
        return float("inf")

    def bounded(self, since: float) -> bool:
        """Whether all inputs since then were within the actuator's limits, applied or commanded."""
        actuator = self.rig.actuators[0]
        applied = [entry[3] for entry in self.measured if entry[0] >= since]
        commanded = [effort for moment, effort in self.commands if moment >= since and math.isfinite(effort)]
        values = np.array([*applied, *commanded])
        return bool(np.all((values >= actuator.low - 1e-9) & (values <= actuator.high + 1e-9)))

    def inside(self, since: float) -> bool:
        """Whether the rig was within its travel, its stops not touched, as its sensor shows it."""
        low, high = self.rig.travel_of_outputs[:, 0]
        positions = np.array([entry[2] for entry in self.measured if entry[0] >= since])
        return bool(np.all((positions > low) & (positions < high)))

    def alive(self) -> None:
        """Raises UserError where a node has ended by itself."""
        for name, child in self.session.children.items():
            if child.process.poll() is not None:
                raise UserError(f"{name} has ended: {child.complaint}")


def process_of(stage: Stage, name: str) -> int:
    """Process of a node."""
    return int(stage.session.children[name].process.pid)


def freeze(stage: Stage, name: str, seconds: float) -> None:
    """SIGSTOP, and SIGCONT after a while."""
    os.kill(process_of(stage, name), signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(process_of(stage, name), signal.SIGCONT)


__all__ = ["JointTrajectory", "Relay", "Said", "Stage", "freeze", "process_of"]
