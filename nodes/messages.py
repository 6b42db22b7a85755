"""Messages: stamps and joints in and out. Numbers pass float() and int() here: rclpy does not check its fields."""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Duration, Time
from sensor_msgs.msg import JointState

SECOND = 1_000_000_000  # ns


def nanoseconds(stamp: Time | Duration) -> int:
    """A stamp or a duration [ns]."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_nanoseconds(stamp: Time | Duration, value: int) -> None:
    """Write nanoseconds into a stamp or a duration."""
    stamp.sec, stamp.nanosec = divmod(int(value), SECOND)


def entry(names: Sequence[str], values: Sequence[float], joint: str) -> float:
    """A joint's entry of a list of a JointState, NaN where there is none."""
    try:
        return float(values[names.index(joint)])
    except (ValueError, IndexError):
        return math.nan


def joint_state(names: Sequence[str]) -> JointState:
    """A message of these joints, to be filled again and again."""
    return JointState(name=list(names))


def fill(
    message: JointState,
    stamp: int,
    *,
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> JointState:
    """Write a stamp [ns] and the lists of a JointState."""
    set_nanoseconds(message.header.stamp, stamp)
    message.position = [float(value) for value in position]
    message.velocity = [float(value) for value in velocity]
    message.effort = [float(value) for value in effort]
    return message
