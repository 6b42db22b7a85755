"""Sensor monitoring: the kernels of a sensor monitor, over its memory. They are Python, and are printed as C."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.estimation.suspicion import CLEAREST, suspicion
from hybrid_sysid_ros.support.arrays import Floats

NONE = -1
"""The index of no sensor, and of no input."""
AVERAGE, LONG_AVERAGE = 0.1, 0.4
"""Time constants [s] of the mean squares that are compared with the largest and with the least that is plausible."""
STANDS_OUT = 20.0
"""Mean square that is evidence, too, where an estimate without one sensor explains all others: what the model does not
know would show in these as well."""
LASTING = 2.0
"""Weight of the longer mean square: a load or a reversal that the model does not know is soon over."""
MISSING = 2.0
"""Evidence that a sensor gives which shows nothing, where the others do not tell the state."""
AGREES = 0.5
"""Share of the largest mean square within which a sensor that was left out agrees with the estimate again."""
BLAMELESS = 3.0
"""Time [s] for which no sensor is left out after it was in vain, since the model or an actuator is wrong then."""
SUDDEN = 2.0
"""Multiple of the largest mean square that is still plausible, by which a first suspicious reading has jumped: what an
actuator does shows in a sensor by and by. Found by trial on rehearsed faults."""
STEADY = 3.0
"""Mean square until which a sensor has agreed: only from there it can have jumped, and has not drifted away."""
STAYS = 1.0
"""Time [s] after which a reading outside of the rig's range is no moment's error, whether it is believed or not."""
AGREED = 0.2
"""Time [s] for which another estimate, of all sensors, must have agreed with them before it is the loop's, and a sensor
that was left out is used again: an estimate that has begun anew believes them all at first."""


@dataclass(slots=True)
class MonitorRecord:
    """What all sensors share. leave_after, timeout [s]: of suspicion, and without a reading after which a sensor counts
    as missing.
    """

    leave_after: float
    timeout: float
    alone: float
    """Time [s] for which the model may go on alone, without sensors that jumped; 0 where the rig can rest instead."""
    given_up: float = BLAMELESS
    """Since it was in vain to leave one out [s]."""
    spent: float = 0.0
    """For how long it has [s]."""
    calm: float = BLAMELESS
    """Since a sensor was under suspicion or left out last [s]."""
    jumped: int = 0
    """How many sensors jumped at once after such a time."""


@dataclass(slots=True)
class MonitoredSensor:
    """A sensor, judged by its normalised innovations, whose mean square is 1 where model and noise are right.

    Evidence against it is r = max(m / largest, LASTING M / largest, least / M), of the mean squares m over AVERAGE and
    M over LONG_AVERAGE, and its suspicion grows as :func:`~.suspicion.suspicion` says.
    """

    spare: bool
    """Whether it can be left out; see :func:`~.observability.spare_sensors`."""
    covered: bool
    """Whether a further channel shows its output, too."""
    noise: float
    """Its deviation with its hum [output unit]."""
    largest: float
    """Mean square that is still plausible."""
    least: float
    """The same; 0: none is too small."""
    low: float
    """Lowest reading within the rig's range [output unit]."""
    high: float
    """Highest one."""
    stops: bool
    """Whether beyond are stops, at which the rig has fallen: the model ends there, and contradicts the sensors."""
    beyond: float = 0.0
    """For how long it has shown that [s]."""
    left_out: bool = False
    away: bool = False
    """Whether it jumped off what was expected, and not back: it lies, even where an estimate that believes it explains
    the others, too.
    """
    is_back: bool = False
    """Whether it has jumped back, or agreed with the estimate without it, since it was left out."""
    silent: float = 0.0
    """Since its last reading [s]."""
    back: float = BLAMELESS
    """Since it was let back, for it agreed with the others [s]."""
    relapses: int = 0
    """How often it was left out again soon after that."""
    seconds: float = 0.0
    """Suspicion [s]."""
    mean: float = 1.0
    """m."""
    lasting: float = 1.0
    """M."""
    large: float = 0.0
    """r of innovations that are too large, without those that are too small."""
    evidence: float = 0.0
    """r while it is used."""
    reading: float = math.nan
    """The last one while it is left out, and what that was off the expected one."""
    off: float = math.nan
    count: int = 0
    """How often it was left out."""


def renew(sensors: Sequence[MonitoredSensor]) -> None:
    """Forget the innovations of an estimate that has begun anew."""
    for k in range(len(sensors)):
        sensors[k].mean = sensors[k].lasting = 1.0
        sensors[k].large = 0.0


def judge_sensors(
    monitor: MonitorRecord,
    sensors: Sequence[MonitoredSensor],
    readings: Floats,
    normalised: Floats,
    expected: Floats,
    elapsed: float,
    which: int,
    stands_out: bool,
) -> None:
    """Take in an update after ``elapsed`` [s]: readings (outputs,), NaN where there is none, the parts (outputs,) of
    the normalised innovation, and, where a sensor is left out, what the estimate expects (outputs,). which, stands_out:
    the sensor that is left out once any one is under suspicion for ``leave_after``, and whether an estimate explains
    all others, of :mod:`~.sensor_bank`. It comes back by :func:`readmit`.
    """
    count, most = len(sensors), 0.0
    for k in range(count):
        sensors[k].silent = sensors[k].silent + elapsed if math.isnan(readings[k]) else 0.0
        sensors[k].back += elapsed
        is_inside = not (readings[k] < sensors[k].low or readings[k] > sensors[k].high)
        sensors[k].beyond = 0.0 if is_inside else sensors[k].beyond + elapsed
        if sensors[k].left_out:
            _compare(monitor, sensors, k, readings[k], expected[k], elapsed)
        else:
            if sensors[k].seconds == 0.0 and sensors[k].mean < STEADY:
                sensors[k].away = normalised[k] > SUDDEN * sensors[k].largest
            r = _evidence(monitor, sensors, k, normalised[k], elapsed, stands_out)
            seconds = suspicion(sensors[k].seconds, r, elapsed, 2.0 * monitor.leave_after)
            sensors[k].evidence, sensors[k].seconds = r, seconds
    if _is_vain(monitor, sensors) or _shows_a_fall(sensors):
        _give_up(sensors)
        monitor.given_up = 0.0
    for k in range(count):
        most = max(most, sensors[k].seconds)
    if which != NONE and most >= monitor.leave_after and _may_leave(monitor, sensors, which):
        _leave_out(sensors, which)


def go_on_alone(monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], elapsed: float) -> None:
    """Leave out all sensors for a while if more than one jumped at once: what an actuator does shows by and by, so that
    the readings are wrong, and those that look right are believed no more than the others. The monitor's times go on
    here, since estimates that are only tried are judged by :func:`judge_sensors` with the same one.
    """
    jumped, out, most = 0, 0, 0.0
    monitor.given_up += elapsed
    for k in range(len(sensors)):
        jumped += 1 if sensors[k].away else 0
        out += 1 if sensors[k].left_out else 0
        most = max(most, sensors[k].seconds)
    if most > 0.0 and monitor.calm > 0.0:
        monitor.jumped = jumped if monitor.calm >= BLAMELESS else 0
    monitor.calm = 0.0 if most > 0.0 else monitor.calm + elapsed
    monitor.spent = monitor.spent + elapsed if out > 1 else 0.0
    if monitor.spent > monitor.alone:
        _give_up(sensors)
        monitor.jumped = 0
    elif have_jumped(monitor) and out > 1 and jumped == 0:
        readmit(sensors)
    elif have_jumped(monitor) and most >= monitor.leave_after:
        for k in range(len(sensors)):
            if sensors[k].spare and not sensors[k].left_out:
                _leave_out(sensors, k)


def have_jumped(monitor: MonitorRecord) -> bool:
    """Whether the readings are wrong, and no actuator is, and the model may go on alone."""
    return monitor.alone > 0.0 and monitor.jumped > 1 and monitor.calm == 0.0


def _leave_out(sensors: Sequence[MonitoredSensor], k: int) -> None:
    sensors[k].left_out, sensors[k].is_back, sensors[k].evidence = True, False, 0.0
    sensors[k].mean = CLEAREST * sensors[k].largest
    sensors[k].reading = sensors[k].off = math.nan
    sensors[k].count += 1
    sensors[k].relapses = sensors[k].relapses + 1 if sensors[k].back < BLAMELESS else 0
    for j in range(len(sensors)):
        if j != k:
            sensors[j].mean = sensors[j].lasting = 1.0
            sensors[j].large = sensors[j].seconds = 0.0


def _give_up(sensors: Sequence[MonitoredSensor]) -> None:
    """Use all sensors again: the model or an actuator is to blame, and none is left out for a while."""
    readmit(sensors)
    for k in range(len(sensors)):
        sensors[k].back = BLAMELESS


def _evidence(
    monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], k: int, square: float, elapsed: float, stands_out: bool
) -> float:
    if sensors[k].silent > monitor.timeout:
        return 0.0 if sensors[k].spare else MISSING
    largest, least = sensors[k].largest, sensors[k].least
    if math.isfinite(square):
        clear = min(square, CLEAREST * largest)  # so that one wild reading is no evidence
        sensors[k].mean += min(elapsed / AVERAGE, 1.0) * (clear - sensors[k].mean)
        clear = min(clear, LASTING * largest)  # so that it is forgotten soon
        sensors[k].lasting += min(elapsed / LONG_AVERAGE, 1.0) * (clear - sensors[k].lasting)
    sensors[k].large = max(sensors[k].mean, LASTING * sensors[k].lasting) / largest
    if stands_out:
        sensors[k].large = max(sensors[k].large, sensors[k].mean / STANDS_OUT)
    small = 0.0
    if least > 0.0:
        small = least / sensors[k].lasting if sensors[k].lasting > 0.0 else CLEAREST
    return max(sensors[k].large, small)


def _compare(
    monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], k: int, reading: float, expected: float, elapsed: float
) -> None:
    """Find whether a sensor agrees with the estimate again, or has jumped back."""
    largest, off = sensors[k].largest, reading - expected
    jump = min(abs(reading - sensors[k].reading), abs(off - sensors[k].off))
    sensors[k].reading, sensors[k].off = reading, off
    if jump > sensors[k].noise * math.sqrt(2.0 * SUDDEN * largest) or sensors[k].silent > monitor.timeout:
        sensors[k].away, sensors[k].is_back = False, True
    square = min((off / sensors[k].noise) * (off / sensors[k].noise), CLEAREST * largest)
    agrees = False
    if math.isfinite(square):
        sensors[k].mean += min(elapsed / AVERAGE, 1.0) * (square - sensors[k].mean)
        agrees = sensors[k].mean < AGREES * largest
    evidence = 0.0 if agrees else CLEAREST
    sensors[k].seconds = suspicion(sensors[k].seconds, evidence, elapsed, 2.0 * monitor.leave_after)
    sensors[k].is_back = sensors[k].is_back or sensors[k].seconds == 0.0


def readmit(sensors: Sequence[MonitoredSensor]) -> None:
    """Use all sensors again."""
    for k in range(len(sensors)):
        if sensors[k].left_out:
            _admit(sensors, k)


def _admit(sensors: Sequence[MonitoredSensor], k: int) -> None:
    sensors[k].left_out, sensors[k].seconds, sensors[k].back = False, 0.0, 0.0
    sensors[k].mean = sensors[k].lasting = 1.0
    sensors[k].large = 0.0


def is_any_left_out(sensors: Sequence[MonitoredSensor]) -> bool:
    """Whether a sensor is left out now."""
    found = False
    for k in range(len(sensors)):
        found = found or sensors[k].left_out
    return found


def only_left_out(sensors: Sequence[MonitoredSensor]) -> int:
    """The one sensor that is left out now, NONE where none or several are."""
    found, count = NONE, 0
    for k in range(len(sensors)):
        if sensors[k].left_out:
            found, count = k, count + 1
    return found if count == 1 else NONE


def has_relapsed(sensors: Sequence[MonitoredSensor]) -> bool:
    """Whether a sensor is left out again that agreed with the others for a while: it is wrong, and no input is."""
    found = False
    for k in range(len(sensors)):
        found = found or (sensors[k].left_out and sensors[k].relapses > 0)
    return found


def _is_vain(monitor: MonitorRecord, sensors: Sequence[MonitoredSensor]) -> bool:
    """Whether a sensor that is used contradicts the model as long as it may: then it was wrong to leave another one
    out, and the model or an actuator is.
    """
    for k in range(len(sensors)):
        suspected = sensors[k].seconds >= 2.0 * monitor.leave_after
        if not sensors[k].left_out and sensors[k].large > 1.0 and suspected:
            return is_any_left_out(sensors)
    return False


def _shows_a_fall(sensors: Sequence[MonitoredSensor]) -> bool:
    """Whether a sensor that is left out goes on showing that the rig lies at its stop: it is believed then."""
    found = False
    for k in range(len(sensors)):
        found = found or (sensors[k].left_out and sensors[k].stops and sensors[k].beyond > STAYS)
    return found


def _may_leave(monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], which: int) -> bool:
    """Whether a sensor may be left out; one that relapses is known."""
    if monitor.given_up < BLAMELESS and not sensors[which].back < BLAMELESS:
        return False
    for j in range(len(sensors)):
        if sensors[j].left_out or (j != which and sensors[j].silent > monitor.timeout):
            return False
    return True


def without(monitor: MonitorRecord, sensors: Sequence[MonitoredSensor]) -> int:
    """How many sensors the estimate has to do without now."""
    count = 0
    for k in range(len(sensors)):
        if not sensors[k].covered and (sensors[k].left_out or sensors[k].silent > monitor.timeout):
            count += 1
    return count


def is_contradicted(sensors: Sequence[MonitoredSensor]) -> bool:
    """Whether innovations are too large, not only too small, which leads no estimate astray."""
    found = False
    for k in range(len(sensors)):
        found = found or (sensors[k].large > 1.0 and not sensors[k].left_out)
    return found


def doubt_of(sensors: Sequence[MonitoredSensor]) -> float:
    """The strongest evidence against the estimate, as a multiple of its threshold."""
    most = 0.0
    for k in range(len(sensors)):
        if not sensors[k].left_out:
            most = max(most, sensors[k].evidence)
        if sensors[k].beyond > STAYS:
            most = max(most, MISSING)
    return most
