"""The drift alarm of an estimator: sums over the innovations of a running loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.extensions.drift_alarm.cumulative_sum import SelfStartingSum, threshold_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array

HOURS = 10.0
"""Mean time between false alarms [h] of a loop that goes on as it began."""
BLOCK = 1.0
"""Seconds of innovations that are one value, since a mean of many is nearly normal and independent of the next."""

STILL = 3
"""Blocks in which no input changed, after which a loop was stopped, and begins as a new one when one does."""


class DriftAlarm:
    """Watches the mean of each output's normalised innovations, and the logarithm of the mean of their squares.

    It counts no block in which the inputs stand still: a rig at rest says nothing of its model in motion.
    """

    def __init__(self, model: Model, rate: float) -> None:
        """rate: of estimates [1/s]."""
        self._names = [item.name for item in model.system.outputs]
        self._size = max(round(BLOCK * rate), 2)
        self._seconds = self._size / rate
        blocks = HOURS * 3600.0 / self._seconds
        self._threshold = threshold_of(blocks * (2 * len(self._names) + 1))  # one-sided sums share the false alarms
        self._still, self._applied = 0, np.zeros(0)
        self._begin()

    def _begin(self) -> None:
        """Forget what the loop showed, and the alarm."""
        self._means = [SelfStartingSum(self._threshold, both=True) for _ in self._names]
        self._sizes = SelfStartingSum(self._threshold, both=False)
        self._sum, self._squares = np.zeros(len(self._names)), np.zeros(len(self._names))
        self._count = self._blocks = 0
        self._words = ""

    def see(self, estimate: StateEstimate, applied: Array) -> None:
        """Take an estimate, and the inputs (m,) that acted."""
        squares = estimate.normalised
        self._watch_inputs(applied)
        if not np.isfinite(squares).all():
            return
        self._sum += np.copysign(np.sqrt(squares), estimate.innovation)
        self._squares += squares
        self._count += 1
        if self._count < self._size:
            return
        if self._still < self._size:
            self._take_block()
        self._sum[:] = self._squares[:] = 0.0
        self._count, self._blocks = 0, self._blocks + 1

    def _watch_inputs(self, applied: Array) -> None:
        """Count for how many estimates no input has changed; one that is not known, NaN, may have."""
        if np.array_equal(applied, self._applied):
            self._still += 1
            return
        if self._still >= STILL * self._size:
            self._begin()
        self._still, self._applied = 0, applied.copy()

    def _take_block(self) -> None:
        for value, each in zip((self._sum / self._count).tolist(), self._means, strict=True):
            each.add(value)
        self._sizes.add(math.log(max(float(self._squares.mean()) / self._count, 1e-300)))
        if not self._words:
            self._words = self._found()

    def _found(self) -> str:
        moved = [name for name, each in zip(self._names, self._means, strict=True) if each.crossed]
        if not moved and not self._sizes.crossed:
            return ""
        what = f"innovations of {', '.join(moved)} have moved" if moved else "innovations have grown"
        when = f"{(self._blocks + 1) * self._seconds:.0f} s"
        return f"{what} at {when}: the model may no longer be the rig's, or the loop does something new"

    def report(self) -> tuple[str, Mapping[str, object]]:
        """What is wrong, "" for nothing, and values for the diagnostics."""
        most = max(max(each.up, each.down) for each in (*self._means, self._sizes))
        return self._words, {
            "drift_sum": most,
            "drift_threshold": self._sizes.threshold,
            "drift_false_alarm_hours": HOURS,
        }


def alarm_of(model: Model, settings: Mapping[str, Any]) -> DriftAlarm:
    """The alarm for an estimator's model and parameters."""
    return DriftAlarm(model, settings["rate"])
