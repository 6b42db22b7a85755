"""Where nodes are tested: in this process, on a domain of its own.

The executor spins in the test, until what is waited for has happened; nothing sleeps.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from hybrid_sysid_ros.nodes import middleware, plant
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.executors import Executor
from hybrid_sysid_ros.nodes.messages import nanoseconds, set_nanoseconds

PATIENCE = 20.0  # s of waiting for an event
VOLT = math.radians(1.3)


class Bench:
    """Nodes on one executor, and a probe that publishes and keeps what it hears, in order, by topic."""

    def __init__(self, domain: int, namespace: str = "cam_beam", *, executor: type[Any] = Executor) -> None:
        self.namespace = namespace
        plant.START_DELAY = 0.0  # all is in this process
        middleware.prepare_middleware()
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = executor(context=self.context)
        self.nodes: list[Node] = []
        self.heard: dict[str, list[Any]] = {}
        self.probe = Node("probe", context=self.context, namespace=namespace)
        self.add(self.probe)

    def add(self, node: Node) -> Node:
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def start(self, kind: Callable[..., RigNode], /, **parameters: Any) -> Any:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self.add(kind(context=self.context, namespace=self.namespace, parameter_overrides=overrides))

    def listen(self, topic: str, message_type: Any = JointState) -> list[Any]:
        self.heard[topic] = []
        self.probe.create_subscription(message_type, topic, self.heard[topic].append, 1000)
        return self.heard[topic]

    def speak(self, topic: str, message_type: Any = JointState) -> Any:
        return self.probe.create_publisher(message_type, topic, 10)

    def until(self, condition: Callable[[], Any]) -> Any:
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.05)
        return found

    def close(self) -> None:
        self.executor.shutdown()
        for node in reversed(self.nodes):
            node.destroy_node()
        self.context.try_shutdown()


def ask(bench: Bench, kind: Any, name: str, request: Any) -> Any:
    """Call a service as a tool would."""
    client = bench.probe.create_client(kind, name)
    bench.until(client.service_is_ready)
    answer = client.call_async(request)
    bench.until(answer.done)
    bench.probe.destroy_client(client)
    return answer.result()


def joint(
    stamp: int,
    *,
    name: Sequence[str] = ("beam",),
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> JointState:
    message = JointState(name=list(name), position=list(position), velocity=list(velocity), effort=list(effort))
    set_nanoseconds(message.header.stamp, stamp)
    return message


def stamp_of(message: Any) -> int:
    return nanoseconds(message.header.stamp)
