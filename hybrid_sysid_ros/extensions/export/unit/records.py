"""Records of kernels, which Python keeps in objects, as the arrays that are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.safety.failsafe import Evidence, Failsafe
from hybrid_sysid_ros.control.safety.governor import GovernedOutput, ReferenceGovernor
from hybrid_sysid_ros.control.safety.guarding import GuardedInput, GuardMemory, GuardRecord, StateRange
from hybrid_sysid_ros.estimation.frozen_sensor import FrozenSensorDetector
from hybrid_sysid_ros.estimation.monitored_estimator import EstimateWatch, MonitoredEstimator
from hybrid_sysid_ros.estimation.reversed_input import ReversalTrial
from hybrid_sysid_ros.estimation.sensor_bank import BankMember, SensorTrial
from hybrid_sysid_ros.estimation.sensor_monitoring import MonitoredSensor, MonitorRecord
from hybrid_sysid_ros.support.arrays import Array

RECORD_NAMES = {
    Evidence: "evidence_record",
    Failsafe: "failsafe_record",
    GovernedOutput: "output_record",
    ReferenceGovernor: "governor_record",
    GuardedInput: "input_record",
    GuardRecord: "guard_record",
    StateRange: "range_record",
    FrozenSensorDetector: "detector_record",
    EstimateWatch: "watch_record",
    SensorTrial: "trial_record",
    BankMember: "member_record",
    ReversalTrial: "reversal_record",
    MonitoredSensor: "sensor_record",
    MonitorRecord: "monitor_record",
}
"""In C."""


@cache
def record_type(kind: type) -> np.dtype[Any]:
    """The type of the elements of an array of such records."""
    return np.dtype([(item.name, "f8" if item.type == "float" else "i8") for item in fields(kind)])


def records(items: Sequence[Any]) -> NDArray[Any]:
    """Records, or numbers, as an array."""
    kind: Any = type(items[0]) if len(items) else float
    if kind not in RECORD_NAMES:
        return np.array(items, dtype=float)
    names = [item.name for item in fields(kind)]
    return np.array([tuple(getattr(item, name) for name in names) for item in items], record_type(kind))


def guard_records(guard: GuardMemory) -> GuardMemory:
    """The memory of a guard as arrays."""
    return GuardMemory(*map(records, guard))  # type: ignore[arg-type]


class SensorWatch(NamedTuple):
    """The memory of a monitored estimator's own kernels, as arrays."""

    core: Any
    """(1,) of :class:`MonitorRecord`."""
    watch: Any
    """(1,) of :class:`EstimateWatch`."""
    sensors: Any
    """(p,)."""
    detectors: Any
    """(p,)."""
    ring: Any
    shown: Array
    """(p,), readings of the newest measurement, NaN where a sensor is frozen."""
    limits: Array
    """(m,), of the disturbance."""
    members: Any
    """(p,) of :class:`BankMember`."""
    trial: Any
    """(1,) of :class:`SensorTrial`; (0,) where no sensor can be left out, and so there is no bank."""
    agreement: Any
    """(p,), the sensors as the estimate of all of them judges them; (0,)."""
    whole: Array
    """(p,), normalised innovations of that."""
    reversal: Any
    """(1,) of :class:`ReversalTrial`; (0,) where no input may be reversed, and so no two estimates compete."""
    judge: Any
    """(p,), the sensors as the estimate with the other sign judges them; (0,)."""
    reversible: Array
    """(m,): 1 for an input that may be."""
    estimates: int
    """How many there are in all."""


def watch_records(estimator: MonitoredEstimator) -> SensorWatch:
    """The memory of what watches an estimate."""
    monitor, spare = estimator.monitor, sum(item is not None for item in estimator.bank)
    count = min(spare, 1)
    competing = 1 if estimator.rivals else 0
    return SensorWatch(
        core=records([monitor.record]),
        watch=records([estimator.watch]),
        sensors=records(monitor.sensors),
        detectors=records(estimator.frozen),
        ring=np.array(estimator.ring),
        shown=np.zeros(len(monitor.sensors)),
        limits=estimator.limits.copy(),
        members=records(estimator.members),
        trial=records([estimator.tried])[:count],
        agreement=records(estimator.agreement.sensors)[: count * len(monitor.sensors)],
        whole=np.zeros(len(monitor.sensors)),
        reversal=records([estimator.reversal])[:competing],
        judge=records(estimator.judge.sensors)[: competing * len(monitor.sensors)],
        reversible=np.array(estimator.settings.reversible, dtype=float),
        estimates=1 + spare + 2 * competing,
    )
