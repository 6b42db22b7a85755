"""Messages: what they say of joints, and times. Those that are published more than once are made once, with their
arrays, then filled: an array of doubles takes no number of another kind, which rclpy would not check.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, MutableSequence, Sequence
from typing import NamedTuple

from builtin_interfaces.msg import Duration, Time
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.layout import Lists, Slots

SECOND = 1_000_000_000  # ns
POINT = {"position": "positions", "velocity": "velocities", "effort": "effort"}
"""Lists of a point of a JointTrajectory, by those of a JointState."""


def nanoseconds(stamp: Time | Duration) -> int:
    """A stamp or a duration [ns]."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_nanoseconds(stamp: Time | Duration, value: int) -> None:
    """Write nanoseconds into a stamp or a duration."""
    stamp.sec, stamp.nanosec = divmod(int(value), SECOND)


class Joints(NamedTuple):
    """What a JointState says."""

    source: str
    """Its frame_id, by which its publisher is told from others."""
    stamp: int
    """[ns]"""
    names: Sequence[str]
    lists: Lists

    @classmethod
    def of(cls, message: JointState) -> Joints:
        """What a message says that the middleware has unpacked."""
        header, lists = message.header, (message.position, message.velocity, message.effort)
        return cls(header.frame_id, nanoseconds(header.stamp), message.name, lists)


def point_lists(point: JointTrajectoryPoint) -> Sequence[MutableSequence[float]]:
    """The lists of a point of a trajectory."""
    return point.positions, point.velocities, point.effort


def joint_trajectory(slots: Slots, offsets: Iterable[int]) -> JointTrajectory:
    """A trajectory with the entries of these slots, all NaN, and points so long after its stamp [ns]."""
    message = JointTrajectory(joint_names=slots.names)
    for offset in offsets:
        point = JointTrajectoryPoint()
        for field in slots.fields:
            setattr(point, POINT[field], array("d", [math.nan] * len(slots.names)))
        set_nanoseconds(point.time_from_start, offset)
        message.points.append(point)
    return message
