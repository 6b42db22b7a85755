"""Sensor monitor: which sensors contradict the model, which one is left out for that, and how much doubt remains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.estimation.sensor_monitoring import (
    NONE,
    MonitoredSensor,
    MonitorRecord,
    doubt_of,
    go_on_alone,
    judge_sensors,
    without,
)
from hybrid_sysid_ros.support.arrays import Floats


class SensorMonitor:
    """The kernels' memory of p sensors. record, sensors: see :class:`MonitorRecord`, :class:`MonitoredSensor`."""

    def __init__(
        self,
        spare: Sequence[bool] | NDArray[np.bool_],
        noise: Sequence[float],
        *,
        largest: Sequence[float],
        least: Sequence[float],
        leave_after: float,
        timeout: float,
        alone: float = 0.0,
        covered: Sequence[bool] = (),
        ranges: Sequence[tuple[float, float, bool]] = (),
    ) -> None:
        """See :class:`MonitoredSensor`, each (p,); covered: by default none is; ranges: low, high, stops, or none."""
        covered = covered or [False] * len(noise)
        ranges = ranges or [(-math.inf, math.inf, False)] * len(noise)
        self.record = MonitorRecord(leave_after, timeout, alone)
        rows = zip(map(bool, spare), covered, noise, largest, least, *zip(*ranges, strict=True), strict=True)
        self.sensors = [MonitoredSensor(*row) for row in rows]

    @property
    def left_out(self) -> list[bool]:
        """Which sensors are left out now (p,)."""
        return [sensor.left_out for sensor in self.sensors]

    @property
    def counts(self) -> list[int]:
        """How often each was (p,)."""
        return [sensor.count for sensor in self.sensors]

    @property
    def evidence(self) -> list[float]:
        """Evidence against each sensor that is used (p,)."""
        return [sensor.evidence for sensor in self.sensors]

    @property
    def without(self) -> int:
        """See :func:`without`."""
        return without(self.record, self.sensors)

    @property
    def doubt(self) -> float:
        """See :func:`doubt_of`."""
        return doubt_of(self.sensors)

    def judge(
        self,
        readings: Floats,
        normalised: Floats,
        expected: Floats | None,
        elapsed: float,
        which: int = NONE,
        stands_out: bool = False,
    ) -> None:
        """See :func:`judge_sensors`."""
        known = expected if expected is not None else [math.nan] * len(self.sensors)
        judge_sensors(self.record, self.sensors, readings, normalised, known, elapsed, which, stands_out)
        go_on_alone(self.record, self.sensors, elapsed)
