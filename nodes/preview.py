"""Preview: the reference ahead, out of a JointTrajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.messages import nanoseconds

Array = NDArray[np.float64]


class Preview:
    """Positions of one joint at times [ns], straight lines between; before the first and after the last, held."""

    def __init__(self, times: NDArray[np.int64], positions: Array) -> None:
        self.times = times
        self.positions = positions

    @classmethod
    def of(cls, message: JointTrajectory, joint: str) -> Preview | None:
        """Preview of a message; None where it has not the joint, or its numbers or times make no sense."""
        if joint not in message.joint_names or not message.points:
            return None
        index = message.joint_names.index(joint)
        start = nanoseconds(message.header.stamp)
        try:
            positions = np.array([point.positions[index] for point in message.points])
        except IndexError:
            return None
        times = np.array([start + nanoseconds(point.time_from_start) for point in message.points], dtype=np.int64)
        if not np.isfinite(positions).all() or (np.diff(times) <= 0).any():
            return None
        return cls(times, positions)

    def at(self, times: NDArray[np.int64]) -> Array:
        """Positions at times (points,) [ns].

        Worked out in whole nanoseconds, so that two messages that share a point agree to the last bit.
        """
        right = np.clip(np.searchsorted(self.times, times, side="right"), 1, max(len(self.times) - 1, 1))
        if len(self.times) == 1:
            return np.full(len(times), self.positions[0])
        left = right - 1
        share = (times - self.times[left]) / (self.times[right] - self.times[left])
        share = np.clip(share, 0.0, 1.0)
        return np.asarray((1.0 - share) * self.positions[left] + share * self.positions[right])

    def covers(self, time: int) -> bool:
        """Whether the preview reaches a time [ns]."""
        return bool(self.times[-1] >= time)
