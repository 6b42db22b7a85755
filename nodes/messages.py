"""Messages: the content of joint messages, and times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration, Time
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.signal_layout import FIELDS, Lists
from hybrid_sysid_ros.support.arrays import Array

SECOND = 1_000_000_000  # ns


def nanoseconds(stamp: Time | Duration) -> int:
    """A stamp or a duration [ns]."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def set_nanoseconds(stamp: Time | Duration, value: int) -> None:
    """Write nanoseconds into a stamp or a duration."""
    stamp.sec, stamp.nanosec = divmod(int(value), SECOND)


class JointStates(NamedTuple):
    """Content of a JointState."""

    source: str
    """Its frame_id, which identifies its publisher."""
    stamp: int
    """[ns]"""
    names: Sequence[str]
    lists: Lists

    @classmethod
    def of(cls, message: JointState) -> JointStates:
        """Content of a message that the middleware has unpacked."""
        header, lists = message.header, (message.position, message.velocity, message.effort)
        return cls(header.frame_id, nanoseconds(header.stamp), message.name, lists)


class TrajectoryMessage(NamedTuple):
    """Content of a JointTrajectory."""

    source: str
    """Its frame_id, which identifies its publisher."""
    stamp: int
    """[ns]"""
    names: Sequence[str]
    times: NDArray[np.int64]
    """Times of the points after the stamp, (points,) [ns]."""
    lists: Sequence[Sequence[Array]]
    """Like those of JointStates: numbers (points,) for each name, or an empty list; NaN where a point has none."""

    @classmethod
    def of(cls, message: JointTrajectory) -> TrajectoryMessage:
        """Content of a message that the middleware has unpacked; each point has a number for each name or none."""
        header, points, names = message.header, message.points, message.joint_names
        times = np.array([nanoseconds(point.time_from_start) for point in points], dtype=np.int64)
        lists = []
        for k in range(len(FIELDS)):
            rows = [point_lists(point)[k] for point in points]
            full = any(map(len, rows))
            lists.append([*np.array([row or [math.nan] * len(names) for row in rows]).T] if full else [])
        return cls(header.frame_id, nanoseconds(header.stamp), names, times, lists)


def point_lists(point: JointTrajectoryPoint) -> Lists:
    """The lists of a trajectory's point, in the order of a JointState."""
    return point.positions, point.velocities, point.effort
