"""Reversed input: which one acts with the other sign, by two estimates that differ in it. The kernels are printed as C.

Both begin anew with the same measurement and differ in the sign of one input. Innovations of a filter are linear in
what acts. So those of an input with any gain g lie on a line through both: with e of the sign that the loop sends, e'
of the other one, all in their deviations,

    e(g) = a + g b,   a = (e + e') / 2,   b = (e - e') / 2,   g = -sum a b / sum b^2 with deviation 1 / sqrt(sum b^2)

by least squares, in sums that forget. The logarithm of the likelihood ratio of this g and of no effect at all is
L = g^2 sum b^2 / 2. An offset of the input shows nothing: both estimates learn it. Sources: Willsky, Jones (1976), A
generalized likelihood ratio approach, IEEE TAC 21(1); Wald (1945), Annals of Mathematical Statistics 16(2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.estimation.sensor_monitoring import (
    BLAMELESS,
    NONE,
    MonitoredSensor,
    MonitorRecord,
    has_relapsed,
    is_any_left_out,
    is_contradicted,
    judge_sensors,
    readmit,
    renew,
)
from hybrid_sysid_ros.support.arrays import Floats

RATIO = 30.0
"""L from which on a gain below zero is believed. Wald's threshold for a share alpha of errors is log 1/alpha, 14 for
1e-6; innovations of a real rig are neither white nor normal, and the filters are asked every period."""
MEMORY = 0.3
"""Time constant [s] of the sums: a gain that has changed must be known anew before much has moved."""
STRONGEST = -3.0
"""The gain farthest below zero: a larger one is that of an input that hardly moved."""
SURE = 0.04
"""Time [s] for which L must have been beyond RATIO: one wild reading must not be enough, nor two."""
CONSISTENT = 0.2
"""Time [s] for which e(g) must have agreed with all sensors before the other sign is believed: an offset that grows
looks like a gain below zero for less. For an input's own sign half of it is enough, which a mean square needs to
contradict: that one is likelier, and a wrong one loses the rig."""
WRONG = 0.3
"""Time [s] for which e(g) may contradict a sensor: then the gain has changed in between, and both begin anew."""
QUIET = 0.2
"""Time [s] without evidence against the loop's estimate after which the other two are given up."""


@dataclass(slots=True)
class ReversalTrial:
    """Two estimates that differ. tried: the input whose sign they differ in. reversed: the one that acts with the other
    sign, NONE: none does. product, power: the sums of a b and b^2; product is NaN where they must begin. sound: for how
    long e(g) has agreed with all sensors, below zero: contradicted one [s]. sure: for how long L has been beyond RATIO
    [s]. quiet: since there was evidence against the loop's estimate [s].
    """

    tried: int = NONE
    reversed: int = NONE
    product: float = math.nan
    power: float = 0.0
    sound: float = 0.0
    sure: float = 0.0
    quiet: float = 0.0


def begin_trial(trial: ReversalTrial, sensors: Sequence[MonitoredSensor]) -> None:
    """Begin with estimates that begin anew; sensors: as those have them."""
    renew(sensors)
    trial.product = trial.power = trial.sound = trial.sure = 0.0


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
    if trial.quiet > QUIET or has_relapsed(sensors):
        trial.product = math.nan
    for k in range(len(sensors)):
        any_shown = any_shown or math.isfinite(shown[k])
    if not math.isnan(trial.product):
        return True
    if not doubted or not any_shown or has_relapsed(sensors):
        return False
    if trial.reversed != NONE:
        trial.tried = trial.reversed
    else:
        trial.tried = (trial.tried + 1) % len(reversible)
        while reversible[trial.tried] == 0.0:
            trial.tried = (trial.tried + 1) % len(reversible)
    return True


def signed_roots(innovations: Floats, squares: Floats) -> None:
    """Make of normalised squares (p,), in place, innovations in their deviations."""
    for k in range(len(squares)):
        squares[k] = math.copysign(math.sqrt(squares[k]), innovations[k])


def acts_reversed(
    trial: ReversalTrial, monitor: MonitorRecord, sensors: Sequence[MonitoredSensor], shown: Floats, own: Floats,
    other: Floats, elapsed: float,
) -> bool:  # fmt: skip
    """Weigh an update of both; whether the other sign is believed: e(g) must agree with all sensors (p,), too.

    own, other (p,): e and e'; own becomes the squares of e(g). sensors: as they are judged by e(g).
    """
    kept = max(1.0 - elapsed / MEMORY, 0.0)
    trial.product, trial.power = kept * trial.product, kept * trial.power
    for k in range(len(sensors)):
        a, b = 0.5 * (own[k] + other[k]), 0.5 * (own[k] - other[k])
        if math.isfinite(a) and math.isfinite(b):
            trial.product += a * b
            trial.power += b * b
    found = -trial.product / trial.power if trial.power > 0.0 else 0.0
    gain = min(max(found, STRONGEST), 0.0)
    for k in range(len(sensors)):
        e = 0.5 * (own[k] + other[k]) + gain * 0.5 * (own[k] - other[k])
        own[k] = e * e
    judge_sensors(monitor, sensors, shown, own, shown, elapsed, NONE, False)  # none of them is ever left out
    is_sure = found > STRONGEST and 0.5 * gain * gain * trial.power > RATIO
    trial.sure = trial.sure + elapsed if is_sure else 0.0
    if is_contradicted(sensors):
        trial.sound = min(trial.sound, 0.0) - elapsed
        if trial.sound < -WRONG:
            trial.product = math.nan
    else:
        trial.sound = max(trial.sound, 0.0) + elapsed
    return trial.sound > (CONSISTENT if trial.reversed == NONE else 0.5 * CONSISTENT) and trial.sure > SURE


def believe_other(trial: ReversalTrial, sensors: Sequence[MonitoredSensor]) -> None:
    """Take the other sign for the input's own, and all sensors of the loop's estimate back, which it explains."""
    trial.reversed = trial.tried if trial.reversed == NONE else NONE
    trial.product = math.nan
    readmit(sensors)
    renew(sensors)
    for k in range(len(sensors)):
        sensors[k].seconds, sensors[k].back = 0.0, BLAMELESS
