"""Monitored estimator: an estimator that screens its sensors, tells its doubt, and begins anew where it is astray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation.estimator import Estimator, StateEstimate
from hybrid_sysid_ros.estimation.frozen_sensor import ENOUGH, FrozenSensorDetector, frozen_detectors, is_frozen
from hybrid_sysid_ros.estimation.initialisation import LONGEST_STEP
from hybrid_sysid_ros.estimation.observability import spare_sensors
from hybrid_sysid_ros.estimation.reversed_input import (
    ReversalTrial,
    acts_reversed,
    begin_trial,
    believe_other,
    may_compete,
    signed_roots,
    turn_input,
)
from hybrid_sysid_ros.estimation.sensor_bank import ASTRAY, BankMember, SensorTrial, agrees, explains, suspect, weigh
from hybrid_sysid_ros.estimation.sensor_monitor import SensorMonitor
from hybrid_sysid_ros.estimation.sensor_monitoring import (
    AGREED,
    NONE,
    MonitoredSensor,
    have_jumped,
    is_contradicted,
    only_left_out,
    readmit,
    renew,
)
from hybrid_sysid_ros.estimation.suspicion import LONGEST
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array, Floats

LARGEST_READING = 1e9
"""No sensor shows more [SI]: it counts as no number, or one such reading would make all estimates so."""
DIVERGED = 1.5
"""Evidence of an estimated input disturbance that is at its limit."""
NEARLY = 0.999
"""Share of its limit from which on a disturbance is at it."""
SOUND = 3.0
"""Mean square of normalised innovations within which an estimate agrees with a sensor: 1 is expected."""
GAP = 3.5
"""Periods without a measurement, after which innovations say nothing against the sensors for a while."""


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """When an estimate is doubted. See :class:`~.sensor_monitor.SensorMonitor` for the first six."""

    largest: Sequence[float]
    least: Sequence[float]
    leave_after: float
    timeout: float
    alone: float = 0.0
    ranges: Sequence[tuple[float, float, bool]] = ()
    frozen_after: float
    """Time [s] after which a sensor that is too still is frozen."""
    white_noise: Sequence[float]
    """(p,): by which a sensor is known to be too still [output unit], 0 where it may be."""
    doubt_disturbance: bool
    """Whether a disturbance at its limit is evidence."""
    reversible: list[float]
    """(m,): 1 for an input that may act with the other sign, and is then given it, 0 for others."""


@dataclass(slots=True)
class EstimateWatch:
    """Whether an estimate may be judged, and whether it has gone astray. period: of measurements [s]. patience: of the
    tuning. last: time of the newest measurement [s]. doubted: for how long there has been evidence against it [s].
    unjudged: updates until it is judged. diverged: whether the disturbance is at its limit. astray: begin it anew.
    """

    period: float
    patience: int
    last: float = math.nan
    doubted: float = 0.0
    unjudged: int = 0
    diverged: bool = False
    astray: bool = False


def screen(
    sensors: Sequence[MonitoredSensor], detectors: Sequence[FrozenSensorDetector], ring: Floats, outputs: Floats,
    shown: Floats,
) -> bool:  # fmt: skip
    """Take the readings that no sensor can give, and those of sensors that are frozen or left out, from outputs (p,),
    in place; shown (p,): with those that are left out. Whether a number remains.
    """
    p, any_left = len(sensors), False
    for k in range(p):
        frozen = is_frozen(detectors[k], ring, k, len(ring) // p, outputs[k])
        if frozen or not abs(outputs[k]) < LARGEST_READING:
            outputs[k] = math.nan
        shown[k] = outputs[k]
        if sensors[k].left_out:
            outputs[k] = math.nan
        any_left = any_left or math.isfinite(outputs[k])
    return any_left


def time_to_judge(watch: EstimateWatch, time: float) -> float:
    """For how long [s] an update at a time [s] is evidence, 0 where it is none: behind a gap it is unknown which inputs
    acted in between.
    """
    elapsed, watch.last = time - watch.last, time
    if elapsed > GAP * watch.period:
        watch.unjudged = watch.patience + 1
    judged = elapsed > 0.0 and watch.unjudged == 0
    watch.unjudged = max(watch.unjudged - 1, 0)
    return min(elapsed, LONGEST) if judged else 0.0


def watch_estimate(
    watch: EstimateWatch, sensors: Sequence[MonitoredSensor], disturbance: Floats, limits: Floats,
    elapsed: float,
) -> None:  # fmt: skip
    """Judge an estimate, ``elapsed`` [s] after the last judged one; limits (m,): of its disturbance (m,)."""
    watch.diverged = False
    for j in range(len(disturbance)):
        if abs(disturbance[j]) >= limits[j]:
            watch.diverged = True
    watch.doubted = watch.doubted + elapsed if is_contradicted(sensors) or watch.diverged else 0.0
    if watch.doubted > ASTRAY:
        watch.doubted, watch.astray = 0.0, True


def is_any(readings: Floats) -> bool:
    """Whether one of the readings is a number."""
    found = False
    for k in range(len(readings)):
        found = found or math.isfinite(readings[k])
    return found


class MonitoredEstimator:
    """An estimator with its monitor, and a bank of others that do without one sensor each.

    One of these takes over when its sensor is left out. At its place in the bank all sensors are tried meanwhile, by an
    estimate that begins anew whenever they contradict it. Where that has agreed with them for AGREED seconds, and
    the sensor has jumped back or agrees with the others, or for PROBATION, both change places again.

    Where several jump at once, and the rig can't rest, none is used for a while: the model goes on alone.

    filter: the estimator. monitor: see :class:`~.sensor_monitor.SensorMonitor`. frozen: a detector for each output.
    shown: the readings of the newest measurement (p,), NaN where a sensor is frozen. outputs: those that were used.
    watch: see :class:`EstimateWatch`. bank, members: of :mod:`~.sensor_bank`, None where no estimate can do without the
    sensor. agreement, tried: the monitor of the estimate that tries all, and what came of it. rivals, judge, reversal:
    the two of :mod:`~.reversed_input`, none where no input may be reversed, the monitor of the one with the other sign,
    and what came of it.
    """

    def __init__(
        self, kind: type[Estimator], system: System, tuning: Tuning, settings: MonitorSettings, *, period: float,
        latency: float, step: float = LONGEST_STEP,
    ) -> None:  # fmt: skip
        """kind: the method. period, latency, step: see :class:`~.estimator.Estimator`.

        Raises UserError where no estimator can be made of these.
        """
        self.system, self.tuning, self.settings = system, tuning, settings
        self._kind, self._period, self._latency, self._step = kind, period, latency, step
        self.limits = NEARLY * np.array(tuning.checked(system).disturbance_limit)
        self.limits[~(self.limits > 0.0) | (not settings.doubt_disturbance)] = math.inf
        self._spare = spare_sensors(system, tuning, step=system.sampling_time or step)
        others = {channel.of for channel in tuning.channels.values()}
        self._covered = [item.name in others for item in system.outputs]
        self._deviations = np.hypot(tuning.measurement_noise, tuning.hum_amplitude).tolist()
        self.outputs, self.shown = np.zeros(len(system.outputs)), np.zeros(len(system.outputs))
        self.bank = [self._new() if spare else None for spare in self._spare]
        self.rivals = [self._new() for _ in range(2 if any(settings.reversible) else 0)]
        self.begin()

    def _new(self) -> Estimator:
        return self._kind(self.system, self.tuning, period=self._period, latency=self._latency, step=self._step)

    def _monitor(self, spare: NDArray[np.bool_], largest: Sequence[float]) -> SensorMonitor:
        settings = self.settings
        return SensorMonitor(
            spare,
            self._deviations,
            largest=largest,
            least=settings.least,
            leave_after=settings.leave_after,
            timeout=settings.timeout,
            alone=settings.alone,
            covered=self._covered,
            ranges=settings.ranges,
        )

    def begin(self) -> None:
        """Forget all estimates and counts."""
        self.filter = self._new()
        largest = self.settings.largest
        self.monitor = self._monitor(self._spare, largest)
        sound = np.zeros_like(self._spare), np.minimum(largest, SOUND).tolist()
        self.agreement, self.judge = self._monitor(*sound), self._monitor(*sound)
        self.reversal = ReversalTrial()
        after = round(self.settings.frozen_after / self._period)
        self.frozen, self.ring = frozen_detectors(self.settings.white_noise, after)
        self.watch = EstimateWatch(self._period, self.tuning.patience)
        self.tried = SensorTrial(max(AGREED, ENOUGH * self._period))
        self.members = [BankMember(place) for place in (np.cumsum(self._spare) * self._spare).tolist()]
        self._reset_bank()

    def _reset_bank(self) -> None:
        """Begin all further estimates anew."""
        for other in self.bank:
            if other is not None:
                other.reset()

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """See :meth:`.estimator.Estimator.update`."""
        watch, sensors, given = self.watch, self.monitor.sensors, outputs.tolist()
        any_left = screen(sensors, self.frozen, self.ring, given, shown := given.copy())
        self.outputs[:], self.shown[:] = given, shown
        if watch.astray and any_left:
            watch.astray = False
            self.filter.reset()
            renew(sensors)
        acting = self.acting(applied)
        estimate = self.filter.update(time, self.outputs, acting)
        if elapsed := time_to_judge(watch, time):
            before = only_left_out(sensors)
            others = self._others(before, time, acting, elapsed)
            self._judge(estimate, applied, elapsed)
            estimate = self._chosen(estimate, others, before, elapsed)
            watch_estimate(watch, sensors, estimate.disturbance.tolist(), self.limits.tolist(), elapsed)
            if (
                self.rivals
                and not have_jumped(self.monitor.record)
                and may_compete(self.reversal, sensors, shown, self.settings.reversible, elapsed)
            ):
                estimate = self._compete(time, acting, elapsed) or estimate
        return estimate

    def acting(self, applied: Array) -> Array:
        """What acts of inputs (m,): one that is reversed has the other sign."""
        found = np.array(applied)
        turn_input(found, self.reversal.reversed)  # type: ignore[arg-type]
        return found

    def _judge(self, estimate: StateEstimate, applied: Array, elapsed: float) -> None:
        """Judge the evidence against an estimate, and leave out the sensor that is behind it."""
        monitor, out = self.monitor, sum(self.monitor.counts)
        expected = self.expected(estimate, applied).tolist() if any(monitor.left_out) else None
        normalised, which = estimate.normalised.tolist(), suspect(self.members, monitor.sensors)
        monitor.judge(
            self.shown.tolist(), normalised, expected, elapsed, which, explains(self.members, which, len(applied))
        )
        if sum(monitor.counts) > out:
            self.tried.agreed = math.nan
        if sum(monitor.counts) > out + 1:
            self.filter.loosen()

    def _others(self, before: int, time: float, acting: Array, elapsed: float) -> list[StateEstimate | None]:
        """Update the bank, in which the estimate that tries all sensors is in the place of the one that is left out,
        ``before``.
        """
        found = list[StateEstimate | None]()
        for k, other in enumerate(self.bank):
            given, tries = self.shown.copy(), k == before
            if not tries:
                given[k] = math.nan
            if other is None or not is_any(given.tolist()):
                found.append(None)
                continue
            if tries and math.isnan(self.tried.agreed):
                other.reset()
                renew(self.agreement.sensors)
                self.tried.agreed = 0.0
            estimate = other.update(time, given, acting)
            found.append(estimate)
            if not tries and weigh(self.members, k, self.monitor.sensors, estimate.normalised.tolist(), elapsed):
                other.reset()
        return found

    def _chosen(
        self, estimate: StateEstimate, others: Sequence[StateEstimate | None], before: int, elapsed: float
    ) -> StateEstimate:
        """The estimate that is the loop's from now on: without a sensor that is left out now, or of all sensors once
        that has agreed with them; before: the sensor that was left out until now.
        """
        sensors, second, out = self.monitor.sensors, self.agreement, only_left_out(self.monitor.sensors)
        if before not in (NONE, out) and (given_up := self.bank[before]) is not None:
            given_up.reset()
        found, other = (None, None) if out == NONE else (others[out], self.bank[out])
        if found is None or other is None:
            return estimate
        if out == before:
            normalised, is_back = found.normalised.tolist(), sensors[out].is_back
            if not agrees(self.tried, second.record, second.sensors, self.shown.tolist(), normalised, is_back, elapsed):
                return estimate
            readmit(sensors)
        other.counters, self.filter.counters = self.filter.counters, other.counters
        self.filter, self.bank[out] = other, self.filter
        return found

    def _compete(self, time: float, acting: Array, elapsed: float) -> StateEstimate | None:
        """Update both rivals; the estimate of the one with the other sign where that is believed."""
        reversal, judge, (one, other) = self.reversal, self.judge, self.rivals
        if math.isnan(reversal.product):
            for rival in self.rivals:
                rival.reset()
            begin_trial(reversal, judge.sensors)
        turned = acting.copy()
        turn_input(turned, reversal.tried)  # type: ignore[arg-type]
        estimates = one.update_ungated(time, self.shown, acting), other.update_ungated(time, self.shown, turned)
        own, opposite = (estimate.normalised.tolist() for estimate in estimates)
        for estimate, squares in zip(estimates, (own, opposite), strict=True):
            signed_roots(estimate.innovation.tolist(), squares)
        if not acts_reversed(reversal, judge.record, judge.sensors, self.shown.tolist(), own, opposite, elapsed):
            return None
        other.counters, self.filter.counters = self.filter.counters, other.counters
        self.filter, self.rivals[1] = other, self.filter
        believe_other(reversal, self.monitor.sensors)
        self.watch.doubted = 0.0
        self._reset_bank()
        return estimates[1]

    def expected(self, estimate: StateEstimate, applied: Array) -> Array:
        """Expected readings of the sensors (p,) under inputs (m,)."""
        return output_of(self.system, estimate.state, self.acting(applied) + estimate.disturbance)

    @property
    def without(self) -> int:
        """Of how many sensors and inputs the estimate does not know what they usually do."""
        return self.monitor.without + (self.reversal.reversed != NONE)

    @property
    def doubt(self) -> float:
        """The strongest evidence against the estimate, as a multiple of its threshold."""
        return max(self.monitor.doubt, DIVERGED if self.watch.diverged else 0.0)
