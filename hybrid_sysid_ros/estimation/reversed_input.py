"""Reversed input: which one acts with the other sign, by two estimates that compete. The kernels are printed as C.

Both estimates begin anew with the same measurement, so that what is wrong for both does not count, and differ in the
sign of one input alone. The logarithm of their likelihood ratio is a sum over the innovations e with variance V,

    L+ = max(L + sum (min(e^2 / V, MOST) - min(e'^2 / V', MOST)) / 2, 0)

where those of the other sign have a prime, and begins anew where the sensors contradict that one: where both are wrong,
chance decides. log V'/V is left out, since the input hardly moves a variance. Sources: Wald (1945), Sequential tests of
statistical hypotheses, Annals of Mathematical Statistics 16(2); Page (1954), Biometrika 41.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.estimation.sensor_monitor import (
    AGREED,
    AVERAGE,
    MonitoredSensor,
    MonitorRecord,
    is_any_left_out,
    is_contradicted,
    judge_sensors,
    readmit,
    renew,
)
from hybrid_sysid_ros.support.arrays import Floats

NONE = -1
"""The index of no input."""
RATIO = 30.0
"""L from which on the other sign is believed. Wald's threshold for a share alpha of errors is log 1/alpha, 14 for 1e-6;
innovations of a real rig are neither white nor normal, and the filters are asked every period."""
MOST = 50.0
"""Normalised square beyond which an innovation counts no more: one wild reading must not be enough."""
QUIET = 0.2
"""Time [s] without evidence against the loop's estimate after which the other two are given up. They do not begin anew
before: with many beginnings one of them wins by chance."""


@dataclass(slots=True)
class ReversalTrial:
    """Two estimates that compete. tried: the input whose sign they differ in. reversed: the one that acts with the
    other sign, NONE: none does. ratio: L, NaN where they must begin. sound: for how long the one with the other sign
    has agreed with all sensors [s]. sure: for how long L has been beyond RATIO [s], which must be AVERAGE, since a mean
    square needs that long to contradict. quiet: since there was evidence against the loop's estimate [s].
    """

    tried: int = NONE
    reversed: int = NONE
    ratio: float = math.nan
    sound: float = 0.0
    sure: float = 0.0
    quiet: float = 0.0


def turn_input(inputs: Floats, which: int) -> None:
    """Give one of the inputs (m,), in place, the other sign."""
    if which != NONE:
        inputs[which] = -inputs[which]


def may_compete(
    trial: ReversalTrial, sensors: Sequence[MonitoredSensor], shown: Floats, reversible: Floats, elapsed: float
) -> bool:
    """Whether the two have to be updated with readings (p,); reversible (m,): 1 for an input that may be tried.

    They begin with evidence against the loop's estimate. An input that acts with the other sign is tried for its own
    one, and else one after the other.
    """
    doubted, any_shown = is_contradicted(sensors) or is_any_left_out(sensors), False
    trial.quiet = 0.0 if doubted else trial.quiet + elapsed
    if trial.quiet > QUIET:
        trial.ratio = math.nan
    for k in range(len(sensors)):
        any_shown = any_shown or math.isfinite(shown[k])
    if not math.isnan(trial.ratio):
        return True
    if not doubted or not any_shown:
        return False
    if trial.reversed != NONE:
        trial.tried = trial.reversed
    else:
        trial.tried = (trial.tried + 1) % len(reversible)
        while reversible[trial.tried] == 0.0:
            trial.tried = (trial.tried + 1) % len(reversible)
    return True


def outweighs(
    trial: ReversalTrial, monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], shown: Floats, same: Floats,
    other: Floats, elapsed: float,
) -> bool:  # fmt: skip
    """Weigh an update of both; whether the other sign is believed: it must agree with all sensors (p,), too.

    same, other (p,): the normalised squares of the innovations. sensors: as the estimate with the other sign has them.
    """
    gain = 0.0
    for k in range(len(sensors)):
        if math.isfinite(same[k]) and math.isfinite(other[k]):
            gain += 0.5 * (min(same[k], MOST) - min(other[k], MOST))
    judge_sensors(monitor, sensors, shown, other, shown, elapsed)  # none of them is ever left out
    contradicted = is_contradicted(sensors)
    trial.ratio = 0.0 if contradicted else max(trial.ratio + gain, 0.0)
    trial.sound = 0.0 if contradicted else trial.sound + elapsed
    trial.sure = trial.sure + elapsed if trial.ratio > RATIO else 0.0
    return trial.sound > AGREED and trial.sure > AVERAGE


def believe_other(trial: ReversalTrial, sensors: Sequence[MonitoredSensor]) -> None:
    """Take the other sign for the input's own, and all sensors of the loop's estimate back, which it explains."""
    trial.reversed = trial.tried if trial.reversed == NONE else NONE
    trial.ratio = math.nan
    readmit(sensors)
    renew(sensors)
    for k in range(len(sensors)):
        sensors[k].seconds = 0.0
