"""Preview: the reference ahead, out of a JointTrajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.layout import Slots
from hybrid_sysid_ros.nodes.messages import nanoseconds, point_lists
from hybrid_sysid_ros.support.arrays import Array


class Preview:
    """References (points, outputs) at times (points,) [ns], straight lines between; before the first and after the
    last, held.
    """

    def __init__(self, times: NDArray[np.int64], values: Array) -> None:
        self.times = times
        self.values = values

    @classmethod
    def of(cls, message: JointTrajectory, outputs: Slots, tracked: NDArray[np.bool_]) -> Preview | None:
        """Preview of a message, 0 for the outputs that are not tracked (outputs,); None where it lacks one that is, or
        its numbers or times make no sense.
        """
        if not message.points:
            return None
        values = np.empty((len(message.points), len(outputs)))
        for row, point in zip(values, message.points, strict=True):
            outputs.read(message.joint_names, point_lists(point), row)
        values[:, ~tracked] = 0.0
        start = nanoseconds(message.header.stamp)
        times = np.array([start + nanoseconds(point.time_from_start) for point in message.points], dtype=np.int64)
        if not np.isfinite(values).all() or (np.diff(times) <= 0).any():
            return None
        return cls(times, values)

    def at(self, times: NDArray[np.int64]) -> Array:
        """References (times, outputs) at times [ns].

        Worked out in whole nanoseconds, so that two messages that share a point agree to the last bit.
        """
        if len(self.times) == 1:
            return np.repeat(self.values, len(times), axis=0)
        right = np.clip(np.searchsorted(self.times, times, side="right"), 1, len(self.times) - 1)
        left = right - 1
        share = (times - self.times[left]) / (self.times[right] - self.times[left])
        share = np.clip(share, 0.0, 1.0)[:, None]
        return np.asarray((1.0 - share) * self.values[left] + share * self.values[right])

    def covers(self, time: int) -> bool:
        """Whether the preview reaches a time [ns]."""
        return bool(self.times[-1] >= time)
