"""Sensor bank: estimates that each do without one sensor. The one that explains the other sensors best tells which one
is wrong. The kernels are Python, and are printed as C.

An estimate that has believed a wrong sensor contradicts the right ones, so that innovations alone blame these. The one
without it never did. Source: Frank (1990), Fault diagnosis in dynamic systems using analytical and knowledge-based
redundancy, Automatica 26(3): the generalised observer scheme.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.estimation.sensor_monitoring import (
    AVERAGE,
    BLAMELESS,
    LONG_AVERAGE,
    NONE,
    MonitoredSensor,
    MonitorRecord,
    is_contradicted,
    judge_sensors,
)
from hybrid_sysid_ros.estimation.suspicion import CLEAREST
from hybrid_sysid_ros.support.arrays import Floats

ASTRAY = 0.3
"""Time [s] of evidence against an estimate after which it is initialised again from the next measurement, since it has
diverged and would converge slowly."""
CLEARLY = 2.0
"""Multiple of the least evidence above which that without any other sensor must be."""
KNOWN = 0.1
"""Share of the evidence against the estimate without a sensor that was left out lately, for BLAMELESS."""
SOUND = 4.0
"""Mean of the largest normalised square of an estimate that explains all its sensors: of four, 2.2 is expected."""
PROBATION = 5.0
"""Time [s] for which the estimate of all sensors must agree with one that neither jumped back nor agrees with the
others: one that is wrong will contradict the model in that time."""


@dataclass(slots=True)
class BankMember:
    """An estimate without one of the sensors. place: among a loop's further estimates from 1 on, 0 where there is none,
    since the others do not tell the state. mean, lasting: of its evidence over AVERAGE and LONG_AVERAGE. square: mean
    of the largest normalised square over AVERAGE. doubted: for how long it has been contradicted [s].
    """

    place: int
    mean: float = 0.0
    lasting: float = 0.0
    square: float = 0.0
    doubted: float = 0.0


@dataclass(slots=True)
class SensorTrial:
    """The estimate that tries all sensors while one is left out. enough: for how long it must agree with them [s].
    agreed: for how long it has [s], NaN where it must begin anew.
    """

    enough: float
    agreed: float = math.nan


def weigh(
    members: Sequence[BankMember], k: int, sensors: Sequence[MonitoredSensor], normalised: Floats, elapsed: float
) -> bool:
    """Take in the normalised innovations n (p,) of the estimate without sensor k; whether it has to begin anew.

    Its evidence is sum n_j / largest_j. It is kept where the estimate begins anew, which believes all at first.
    """
    evidence = square = 0.0
    for j in range(len(sensors)):
        if math.isfinite(normalised[j]):
            evidence += min(normalised[j] / sensors[j].largest, CLEAREST)
            square = max(square, min(normalised[j], CLEAREST * SOUND))
    members[k].mean += min(elapsed / AVERAGE, 1.0) * (evidence - members[k].mean)
    members[k].lasting += min(elapsed / LONG_AVERAGE, 1.0) * (evidence - members[k].lasting)
    members[k].square += min(elapsed / AVERAGE, 1.0) * (square - members[k].square)
    members[k].doubted = members[k].doubted + elapsed if members[k].mean > 1.0 else 0.0
    if members[k].doubted > ASTRAY:
        members[k].doubted = 0.0
        return True
    return False


def suspect(members: Sequence[BankMember], sensors: Sequence[MonitoredSensor]) -> int:
    """The sensor without which the others agree best, NONE where they never do, or nearly as well without another one;
    one that was left out lately is known to lie.
    """
    found, least, alike = NONE, 1.0, 0
    for k in range(len(members)):
        evidence = _evidence(members, sensors, k)
        if evidence < least:
            found, least = k, evidence
    for k in range(len(members)):
        if _evidence(members, sensors, k) <= CLEARLY * least:
            alike += 1
    return found if alike == 1 else NONE


def _evidence(members: Sequence[BankMember], sensors: Sequence[MonitoredSensor], k: int) -> float:
    """Against the estimate without sensor k, infinite where there is none."""
    if members[k].place == 0:
        return math.inf
    if sensors[k].back < BLAMELESS:
        return KNOWN * members[k].mean
    return max(members[k].mean, members[k].lasting)


def explains(members: Sequence[BankMember], k: int, inputs: int) -> bool:
    """Whether the estimate without sensor k explains the others as well as a right one does, and these are more than
    the inputs: estimated disturbances could explain as many as there are inputs.
    """
    return k != NONE and members[k].square < SOUND and len(members) - 1 > inputs


def agrees(
    trial: SensorTrial, monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], shown: Floats, normalised: Floats,
    is_back: bool, elapsed: float,
) -> bool:  # fmt: skip
    """Judge an update of the estimate of all sensors (p,); whether it has agreed with them for long enough. is_back: of
    the one that is left out.
    """
    judge_sensors(monitor, sensors, shown, normalised, shown, elapsed, NONE, False)  # none of them is ever left out
    trial.agreed = math.nan if is_contradicted(sensors) else trial.agreed + elapsed
    return trial.agreed > (trial.enough if is_back else PROBATION)
