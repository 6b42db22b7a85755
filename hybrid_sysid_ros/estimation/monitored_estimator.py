"""Monitored estimator: an estimator that screens its sensors, tells its doubt, and begins anew where it is astray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import and_

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation.estimator import Estimator, StateEstimate
from hybrid_sysid_ros.estimation.initialisation import LONGEST_STEP
from hybrid_sysid_ros.estimation.sensor_monitor import ENOUGH, FrozenSensorDetector, SensorMonitor, spare_sensors
from hybrid_sysid_ros.estimation.suspicion import LONGEST
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array

DIVERGED = 1.5
"""Evidence of an estimated input disturbance that is at its limit."""
NEARLY = 0.999
"""Share of its limit from which on a disturbance is at it."""
ASTRAY = 0.3
"""Time [s] of evidence against an estimate after which it is initialised again from the next measurement, since it has
diverged and would converge slowly."""
SOUND = 3.0
"""Mean square of normalised innovations within which an estimate agrees with a sensor: 1 is expected."""
AGREED = 0.2
"""Time [s], and ENOUGH readings at least, for which a second estimate, of all sensors, must have agreed with them
before one that was left out is used again: an estimate that has begun anew believes them all at first."""
GAP = 3.5
"""Periods without a measurement, after which innovations say nothing against the sensors for a while."""


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """When an estimate is doubted. See :class:`~.sensor_monitor.SensorMonitor` for the first four."""

    largest: Sequence[float]
    least: Sequence[float]
    leave_after: float
    timeout: float
    frozen_after: float
    """Time [s] after which a sensor that is too still is frozen."""
    white_noise: Sequence[float]
    """(p,): by which a sensor is known to be too still [output unit], 0 where it may be."""
    doubt_disturbance: bool
    """Whether a disturbance at its limit is evidence."""


class MonitoredEstimator:
    """An estimator with its monitor. It makes no other estimates than the one in it, but for what it leaves out.

    While a sensor is left out, a second estimator of all sensors begins anew whenever they contradict it. It takes the
    place of the first one when it has agreed for AGREED seconds: so a sensor is tried without spoiling the estimate.
    One that jumped must jump back before: an estimate that begins at it has nothing against a slow state that is wrong.

    filter: the estimator. monitor: see :class:`~.sensor_monitor.SensorMonitor`. frozen: a detector for each output.
    shown: the readings of the newest measurement (p,), NaN where a sensor is frozen. outputs: those that were used.
    diverged: whether the estimated disturbance is at its limit.
    """

    def __init__(
        self, kind: type[Estimator], system: System, tuning: Tuning, settings: MonitorSettings, *, period: float,
        latency: float,
    ) -> None:  # fmt: skip
        """kind: the method. period, latency: see :class:`~.estimator.Estimator`.

        Raises UserError where no estimator can be made of these.
        """
        self.system, self.tuning, self.settings = system, tuning, settings
        self._kind, self._period, self._latency = kind, period, latency
        self._limits = NEARLY * np.array(tuning.checked(system).disturbance_limit)
        self._limits[~(self._limits > 0.0) | (not settings.doubt_disturbance)] = math.inf
        self._spare = spare_sensors(system, tuning, step=system.sampling_time or LONGEST_STEP)
        others = {channel.of for channel in tuning.channels.values()}
        self._covered = [item.name in others for item in system.outputs]
        self._deviations = np.hypot(tuning.measurement_noise, tuning.hum_amplitude).tolist()
        self.outputs, self.shown = np.zeros(len(system.outputs)), np.zeros(len(system.outputs))
        self._whole = self._new() if self._spare.any() else None
        self.begin()

    def _new(self) -> Estimator:
        return self._kind(self.system, self.tuning, period=self._period, latency=self._latency)

    def _monitor(self, spare: NDArray[np.bool_], largest: Sequence[float]) -> SensorMonitor:
        settings = self.settings
        return SensorMonitor(
            spare,
            self._deviations,
            largest=largest,
            least=settings.least,
            leave_after=settings.leave_after,
            timeout=settings.timeout,
            covered=self._covered,
        )

    def begin(self) -> None:
        """Forget all estimates and counts."""
        self.filter = self._new()
        largest = self.settings.largest
        self.monitor = self._monitor(self._spare, largest)
        self._agreement = self._monitor(np.zeros_like(self._spare), np.minimum(largest, SOUND).tolist())
        after = round(self.settings.frozen_after / self._period)
        self.frozen = [FrozenSensorDetector(noise, after=after) for noise in self.settings.white_noise]
        self._last, self._doubted, self._unjudged = math.nan, 0.0, 0
        self.diverged = self._astray = False
        self._agreed = math.nan

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """See :meth:`.estimator.Estimator.update`."""
        self.outputs[:] = outputs
        for k, detector in enumerate(self.frozen):
            if detector.is_frozen(float(outputs[k])):
                self.outputs[k] = math.nan
        self.shown[:] = self.outputs
        self.monitor.screen(self.outputs)
        if self._astray and np.isfinite(self.outputs).any():
            self._astray = False
            self.filter.reset()
            self.monitor.renew()
        estimate = self.filter.update(time, self.outputs, applied)
        elapsed, self._last = time - self._last, time
        if elapsed > GAP * self._period:  # it is unknown which inputs acted in between
            self._unjudged = self.tuning.patience + 1
        if elapsed > 0.0 and not self._unjudged:
            self._judge(estimate, applied, min(elapsed, LONGEST))
            if any(self.monitor.left_out):
                self._try_again(time, applied, min(elapsed, LONGEST))
        self._unjudged = max(self._unjudged - 1, 0)
        return estimate

    def _judge(self, estimate: StateEstimate, applied: Array, elapsed: float) -> None:
        """Judge the evidence against an estimate, which begins anew where that lasts too long."""
        expected = self.expected(estimate, applied) if any(self.monitor.left_out) else None
        used = [not out for out in self.monitor.left_out]
        self.monitor.judge(self.shown, estimate.normalised, expected, elapsed)
        if any(map(and_, used, self.monitor.left_out)):
            self.filter.loosen()
            self._agreed = math.nan
        self.diverged = bool((np.abs(estimate.disturbance) >= self._limits).any())
        astray = self.monitor.is_contradicted or self.diverged
        self._doubted = self._doubted + elapsed if astray else 0.0
        if self._doubted > ASTRAY:
            self._doubted, self._astray = 0.0, True

    def _try_again(self, time: float, applied: Array, elapsed: float) -> None:
        """Use all sensors again once a second estimate, which begins anew where they contradict it, agrees with all."""
        whole, begins = self._whole, math.isnan(self._agreed)
        if any(self.monitor.away):
            self._agreed = math.nan
            return
        if whole is None or (begins and not np.isfinite(self.shown).any()):
            return
        if begins:
            whole.reset()
            self._agreement.renew()
            self._agreed = 0.0
        estimate = whole.update(time, self.shown, applied)
        self._agreement.judge(self.shown, estimate.normalised, None, elapsed)
        self._agreed = math.nan if self._agreement.is_contradicted else self._agreed + elapsed
        if self._agreed > max(AGREED, ENOUGH * self._period):
            whole.counters, self.filter.counters = self.filter.counters, whole.counters
            self.filter, self._whole = whole, self.filter
            self.monitor.readmit()

    def expected(self, estimate: StateEstimate, applied: Array) -> Array:
        """Expected readings of the sensors (p,) under inputs (m,)."""
        return output_of(self.system, estimate.state, applied + estimate.disturbance)

    @property
    def doubt(self) -> float:
        """The strongest evidence against the estimate, as a multiple of its threshold."""
        return max(self.monitor.doubt, DIVERGED if self.diverged else 0.0)
