"""Preview: the future reference from a trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.nodes.messages import TrajectoryMessage
from hybrid_sysid_ros.nodes.signal_layout import Slots
from hybrid_sysid_ros.nodes.validation import MessageValidator, Reason
from hybrid_sysid_ros.rigs.rig import BEYOND
from hybrid_sysid_ros.support.arrays import Array


class Preview:
    """References (points, outputs) at times (points,) [ns], linear between points, and constant before the first and
    after the last.
    """

    def __init__(self, times: NDArray[np.int64], values: Array) -> None:
        self.times = times
        self.values = values

    @classmethod
    def of(
        cls,
        message: TrajectoryMessage,
        validator: MessageValidator,
        outputs: Slots,
        tracked: NDArray[np.bool_],
        now: int,
    ) -> Preview | None:
        """Preview of a message, with 0 for outputs that are not tracked (outputs,). None where a tracked output is
        missing, or numbers, times or stamp are rejected, which its validator counts. now: beginning of a message
        without a stamp [ns].
        """
        rows = outputs.read(message.names, message.lists)
        times = (message.stamp or now) + message.times
        values = np.stack([np.broadcast_to(row, times.shape) for row in rows], axis=-1)
        values[:, ~tracked] = 0.0
        if not len(times) or (np.diff(times) <= 0).any():
            validator.drop(Reason.NO_ORDER if len(times) else Reason.MALFORMED)
            return None
        if not (np.abs(values) <= BEYOND).all():
            absent = any(isinstance(row, float) for row, needed in zip(rows, tracked, strict=True) if needed)
            if absent and outputs.named < len(outputs):
                validator.drop(Reason.UNNAMED)
            else:
                validator.drop(Reason.NO_NUMBER if np.isnan(values).any() else Reason.OUT_OF_RANGE)
            return None
        return cls(times, values) if validator.accepts_start(message.stamp) else None

    def within(self, low: Array, high: Array) -> bool:
        """Limit the values to limits, (outputs,) each; return whether they were within."""
        bounded = np.clip(self.values, low, high)
        same = bool((bounded == self.values).all())
        self.values = bounded
        return same

    def at(self, times: NDArray[np.int64]) -> Array:
        """References (times, outputs) at times [ns].

        They are computed in whole nanoseconds, so that two messages that share a point agree to the last bit.
        """
        if len(self.times) == 1:
            return np.repeat(self.values, len(times), axis=0)
        left = np.searchsorted(self.times[1:-1], times, side="right")
        right = left + 1
        share = (times - self.times[left]) / (self.times[right] - self.times[left])
        share = np.minimum(np.maximum(share, 0.0), 1.0)[:, None]  # np.clip is slower
        return np.asarray((1.0 - share) * self.values[left] + share * self.values[right])

    def covers(self, time: int) -> bool:
        """Whether the preview reaches a time [ns]."""
        return bool(self.times[-1] >= time)
