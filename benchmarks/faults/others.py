"""Faults of somebody else who speaks on the topics of the loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from benchmarks.faults.observation import INCOMPATIBLE
from benchmarks.faults.stage import LASTING, NODES, Fault, Stage
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds


def spoken(topic: str, make: Callable[[Stage, int], Any], *, rate: float = 100.0, reliable: bool = True) -> Fault:
    """Messages of somebody else on a topic."""

    def fault(stage: Stage) -> None:
        publisher = stage.publisher(topic, reliable=reliable)
        message = make(stage, 0)  # which takes a second where it is a large one
        stage.started = time.monotonic()
        end, k = stage.started + LASTING, 0
        while time.monotonic() < end:
            publisher.publish(message)
            k += 1
            time.sleep(1.0 / rate)
            message = make(stage, k)
        stage.node.destroy_publisher(publisher)

    return fault


def joint(stage: Stage, stamp: int, **fields: float) -> JointState:
    """A message of somebody else about the rig's joint."""
    message = JointState(name=[stage.joint])
    for name, value in fields.items():
        setattr(message, name, [value])
    set_nanoseconds(message.header.stamp, stamp)
    message.header.frame_id = INCOMPATIBLE
    return message


def now(stage: Stage) -> int:
    """Time of the ROS clock [ns]."""
    return int(stage.node.get_clock().now().nanoseconds)


def newest(stage: Stage) -> int:
    """Stamp of the newest measurement [ns]."""
    return stage.measured[-1].stamp


def command(effort: float, stamp: Callable[[Stage], int], *, reliable: bool = True) -> Fault:
    """Commands with a stamp, at the rate of the loop."""

    def make(stage: Stage, k: int) -> JointState:
        return joint(stage, stamp(stage), effort=effort)

    return spoken("joint_command", make, rate=200.0, reliable=reliable)


def crowd(stage: Stage) -> None:
    """A message with a million names, on each topic of the loop, five times."""
    message = serialize_message(JointState(name=[f"n{k}" for k in range(1_000_000)]))
    stage.started = time.monotonic()
    for topic in ("joint_states", "state_estimate", "joint_command"):
        publisher = stage.publisher(topic)
        for _ in range(5):
            publisher.publish(message)
            time.sleep(0.1)
        stage.node.destroy_publisher(publisher)


def estimate(value: float) -> Fault:
    """Estimates all of whose numbers are the same."""

    def make(stage: Stage, k: int) -> JointState:
        message = JointState(name=[stage.joint, f"{stage.joint}_ahead"])
        for field in ("position", "velocity", "effort"):
            setattr(message, field, [value] * 2)
        set_nanoseconds(message.header.stamp, now(stage))
        message.header.frame_id = INCOMPATIBLE
        return message

    return spoken("state_estimate", make)


def reference(value: float, *, points: int = 2, offset: float = 0.0, spacing: int = SECOND // 1000) -> Fault:
    """References of somebody else, while the rig's own is away."""

    def make(stage: Stage, k: int) -> bytes:
        message = JointTrajectory(joint_names=[stage.joint])
        set_nanoseconds(message.header.stamp, now(stage) + round(offset * SECOND))
        for k in range(points):
            point = JointTrajectoryPoint(positions=[value])
            set_nanoseconds(point.time_from_start, k * spacing)
            message.points.append(point)
        return bytes(serialize_message(message))  # not while it is timed

    def fault(stage: Stage) -> None:
        stage.end("reference")
        spoken("reference", make, rate=20.0 if points < 100 else 2.0)(stage)
        stage.start("reference")
        stage.session.wait_for("ready", ["reference"], 30.0)

    return fault


def no_reference(stage: Stage) -> None:
    """None for a while."""
    stage.kill("reference")
    time.sleep(LASTING)
    stage.restart("reference")


def second(name: str) -> Fault:
    """Another one of the same kind, from the same command."""

    def fault(stage: Stage) -> None:
        first = stage.session.children[name]
        stage.start(name)
        stage.session.wait_for("ready", [name], 30.0)
        stage.started = time.monotonic()
        time.sleep(3.0)
        stage.end(name)
        stage.session.children[name] = first

    return fault


def storm(stage: Stage) -> None:
    """Parameters of all nodes are asked for, and set to what they can't be, as often as they are answered."""
    wrong = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=-1.0)
    asking: list[tuple[Any, Any]] = []
    for name in NODES:
        questions = {
            "get_parameters": (GetParameters, GetParameters.Request(names=["rig"] * 20)),
            "set_parameters": (
                SetParameters,
                SetParameters.Request(parameters=[Parameter(name="warn_share", value=wrong)] * 20),
            ),
        }
        for service, (kind, request) in questions.items():
            client = stage.node.create_client(kind, f"{name}/{service}")
            client.wait_for_service(timeout_sec=5.0)
            asking.append((client, request))
    end = time.monotonic() + LASTING
    while time.monotonic() < end:
        for client, request in asking:
            client.call_async(request)
        time.sleep(1e-3)
    for client, _ in asking:
        stage.node.destroy_client(client)


def empty_diagnostics(stage: Stage) -> None:
    """Diagnostics of nothing."""
    publisher = stage.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    for _ in range(100):
        publisher.publish(DiagnosticArray())
        time.sleep(0.01)
    stage.node.destroy_publisher(publisher)
