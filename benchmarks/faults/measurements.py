"""Faults of the measurements on their way from the rig."""

from __future__ import annotations

import math
import random
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from benchmarks.faults.stage import HEARD, LASTING, Fault, Stage
from hybrid_sysid_ros.nodes.messages import SECOND, nanoseconds, set_nanoseconds

Change = Callable[[JointState], Sequence[JointState]]


@contextmanager
def changed(stage: Stage, change: Change) -> Iterator[None]:
    """Measurements pass through ``change`` for a while."""
    plain, stage.relay.change = stage.relay.change, change
    try:
        yield
    finally:
        stage.relay.change = plain


def measurements(change: Callable[[], Change]) -> Fault:
    """A fault of the measurements on their way."""

    def fault(stage: Stage) -> None:
        with changed(stage, change()):
            time.sleep(LASTING)

    return fault


def lost(share: float) -> Callable[[], Change]:
    """A share of them does not arrive."""
    draw = random.Random(0)
    return lambda: lambda message: [] if draw.random() < share else [message]


def late(periods: int) -> Callable[[], Change]:
    """Each comes so many periods late."""

    def make() -> Change:
        kept: list[JointState] = []

        def change(message: JointState) -> list[JointState]:
            kept.append(message)
            return [kept.pop(0)] if len(kept) > periods else []

        return change

    return make


def reordered() -> Change:
    """Two by two in the wrong order."""
    kept: list[JointState] = []

    def change(message: JointState) -> list[JointState]:
        kept.append(message)
        if len(kept) < 2:
            return []
        found = kept[::-1]
        kept.clear()
        return found

    return change


def stamped(offset: float, *, every: int) -> Callable[[], Change]:
    """One in so many has a stamp that is off by ``offset`` [s]."""

    def make() -> Change:
        count = 0

        def change(message: JointState) -> list[JointState]:
            nonlocal count
            count += 1
            if count % every == 0:
                set_nanoseconds(message.header.stamp, nanoseconds(message.header.stamp) + round(offset * SECOND))
            return [message]

        return change

    return make


def reading(value: Callable[[float, int], float], field: str = "position") -> Callable[[], Change]:
    """Readings, or the inputs beside them, that are made of the true ones and their number."""

    def make() -> Change:
        count = 0

        def change(message: JointState) -> list[JointState]:
            nonlocal count
            count += 1
            setattr(message, field, array("d", [value(each, count) for each in getattr(message, field)]))
            return [message]

        return change

    return make


def same(value: float) -> Callable[[float, int], float]:
    """The same number whatever was read."""
    return lambda read, k: value


def frozen() -> Change:
    """The same reading for ever."""
    kept: list[Any] = []

    def change(message: JointState) -> list[JointState]:
        kept.append(message.position)
        message.position = kept[0]
        return [message]

    return change


def shaped(change: Callable[[JointState], None]) -> Callable[[], Change]:
    """The message itself is another one."""

    def make() -> Change:
        def changed(message: JointState) -> list[JointState]:
            change(message)
            return [message]

        return changed

    return make


def cut(message: JointState) -> None:
    """Without its inputs."""
    message.effort = array("d", [])


def longer(message: JointState) -> None:
    """With more positions than names."""
    message.position = array("d", [*message.position, 1.0, 2.0])


def renamed(message: JointState) -> None:
    """With the names of another rig."""
    message.name = ["arm" for _ in message.name]


def without_numbers(message: JointState) -> None:
    """With names alone."""
    for field in ("position", "velocity", "effort"):
        setattr(message, field, array("d", []))


def with_velocity(message: JointState) -> None:
    """With a list that nobody asks for, which is no number."""
    message.velocity = array("d", [math.nan] * len(message.name))


def twice_named(message: JointState) -> None:
    """With its name twice."""
    message.name = [*message.name, *message.name]
    message.position, message.effort = message.position * 2, message.effort * 2


def with_thousands_of_names(message: JointState) -> None:
    """Of three thousand joints."""
    message.name = [*message.name, *(f"n{k}" for k in range(3000))]
    message.position = array("d", [*message.position, *([0.0] * 3000)])
    message.velocity, message.effort = array("d", []), array("d", [*message.effort, *([0.0] * 3000)])


def best_effort(stage: Stage) -> None:
    """From a driver that repeats nothing that gets lost."""
    reliable, relay = stage.relay.publisher, stage.relay
    relay.publisher = stage.node.create_publisher(
        JointState, HEARD, QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    stage.node.destroy_publisher(reliable)
    time.sleep(1.0 + LASTING)
    stage.alive()
    before = relay.publisher
    relay.publisher = relay.new_publisher()
    stage.node.destroy_publisher(before)
