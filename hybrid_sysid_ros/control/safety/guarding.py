"""Guarding: the kernels of a guard, over its memory. They are Python, and are printed as C."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hybrid_sysid_ros.control.safety.failsafe import AGAIN, NOTHING, Evidence, Failsafe, LoopState, judge_evidence
from hybrid_sysid_ros.control.safety.governor import GovernedOutput, ReferenceGovernor
from hybrid_sysid_ros.estimation.measurement_sequence import LARGEST_INPUT
from hybrid_sysid_ros.estimation.reversed_input import NONE
from hybrid_sysid_ros.estimation.sensor_monitoring import MISSING
from hybrid_sysid_ros.estimation.suspicion import CLEAREST, LONGEST
from hybrid_sysid_ros.support.arrays import Floats

ESTIMATE, ACTUATOR, RANGE, SENSOR, INPUT = 0, 1, 2, 3, 4
"""Causes of a level: indices of the kinds of evidence, a sensor that is missing, and an input that acts reversed."""
SLOWED, HOLDING, RESTING = int(LoopState.SLOWED), int(LoopState.HOLDING), int(LoopState.RESTING)
RECENT = 0.05
"""Time [s], beside its delay, for which an actuator may still be carrying out a command."""
REMEMBERED = 64
"""Commands: at 1 kHz those of RECENT and a little more."""
UNLIKE = 0.5
"""Share of what an actuator was commanded, as a root mean square, by which it may miss that."""
SMALL = 0.1
"""Share of the tolerance below which commands are too small to tell what an actuator makes of them."""
AVERAGE = 0.1
"""Time constant [s] of the mean squares of commands and of what they are missed by."""
RESPONSE = 0.3
"""Time constant [s] of the moments by which an actuator's response is judged."""
REVERSED = 0.6
"""Correlation of commands and what acts, below minus which an actuator does the opposite."""
MIRRORED = 0.05
"""Time [s] for which an actuator has been near the opposite of its commands, and not near them, after which it is sent
the opposite: correlations see the jump to there for long. Six samples of a stuck one may be near by chance, which what
is sent does not move."""
FAR_OFF = 3.0
"""Tolerances by which it must be off them at first: one that is off by a little is near the opposite of its trim."""
TURNED = 1.5
"""Evidence of an actuator that is sent the opposite, since it does the opposite: a stabilised loop goes on slowed."""
TRIMMED = 0.3
"""Time constant [s] in which commands make up for what an actuator is off them."""
ANSWERS = 0.2
"""Share of its commands' changes with which an actuator that is trimmed must change, one way or the other."""
FAR = 5.0
"""Evidence above which an actuator is so far from its commands that a stabilised loop is held, not slowed."""
RETURN = 0.3
"""Time [s] in which inputs get their whole range back: a sensor with the wrong sign looks right while a rig rests, and
must show itself again before much has moved."""
TRIAL = 0.025
"""Share of half their range that inputs have, a stabiliser's among them, when an actuator in doubt is tried again: just
enough to show what it makes of them. A flipped or disconnected one looks right at rest."""


@dataclass(slots=True)
class GuardRecord:
    """A guard's own numbers. act, stabilised, slow_share, recent: see :class:`~.guard.GuardSettings`. share: of half
    their range that inputs have. tried: the same where an actuator is in doubt. row: of the newest command. level: that
    it allows. cause: why that is no more. reversed: the input that acts with the other sign, NONE: none does. fallen:
    whether a state is at a stop from which no stabiliser lifts the rig. doubted, found: how many estimates have left a
    level above driving, and the cause of the last one: a report that comes seldom tells what was in between.
    """

    act: bool
    stabilised: bool
    slow_share: float
    recent: float
    share: float = 1.0
    tried: float = 1.0
    row: int = 0
    level: int = 0
    cause: int = NOTHING
    reversed: int = NONE
    fallen: bool = False
    doubted: int = 0
    found: int = NOTHING


@dataclass(slots=True)
class GuardedInput:
    """An input: its bounds, its fastest change [input unit/s], how far it may be from its commands, and what it is at
    rest. missed, asked: mean squares of what it was off its commands, and of these. sent, acted: means of its commands
    and of what acted. power, spread, common: the variance of the commands, the sum of both, and twice their covariance.
    trim: what is added to commands. mirrored: for how long it has been near the opposite of its
    commands [s]. opposes: whether it is sent the opposite. turned_back: whether it was, and is not any more, since
    there was evidence first. acts: what acted last, NaN where that is near its commands.
    """

    low: float
    high: float
    rate: float
    tolerance: float
    middle: float
    missed: float = 0.0
    asked: float = 0.0
    sent: float = 0.0
    acted: float = 0.0
    power: float = 0.0
    spread: float = 0.0
    common: float = 0.0
    trim: float = 0.0
    mirrored: float = 0.0
    opposes: bool = False
    turned_back: bool = False
    acts: float = math.nan


@dataclass(slots=True)
class StateRange:
    """The range of a state; outside: by how much it must be beyond that for evidence of 1; stops: 1 where its ends are
    stops, 0 elsewhere.
    """

    low: float
    high: float
    outside: float
    stops: float


class GuardMemory(NamedTuple):
    """The memory of a guard of n states, m inputs, p outputs. core, failsafe, governor: one record each. Commands are
    what is to act: see :func:`.commanding.turn`.
    """

    core: Sequence[GuardRecord]
    failsafe: Sequence[Failsafe]
    governor: Sequence[ReferenceGovernor]
    kinds: Sequence[Evidence]
    inputs: Sequence[GuardedInput]
    states: Sequence[StateRange]
    outputs: Sequence[GovernedOutput]
    sent: Floats
    """(REMEMBERED m,): the newest commands, in a ring."""
    replaced: Floats
    """(REMEMBERED,): how long ago each was replaced [s]; the newest one never was."""
    alike: Floats
    """(m m,): by how much input i changes for what input j lacks, row by row; see :func:`.commanding.make_up`."""


def report(guard: GuardMemory, applied: Floats, disturbance: Floats) -> None:
    """Let the estimate report what inputs (m,) of a stabiliser do, in place, whose disturbance (m,) is beyond the
    tolerance: what a stabiliser sends changes faster than a plan, which takes disturbances for constant.
    """
    m = len(guard.inputs)
    for j in range(m):
        is_off = guard.alike[j * m + j] > 0.0 and abs(disturbance[j]) > guard.inputs[j].tolerance
        if guard.core[0].act and is_off and math.isfinite(applied[j]):
            applied[j], disturbance[j] = applied[j] + disturbance[j], 0.0


def judge(
    guard: GuardMemory, doubt: float, without: float, reversed: float, applied: Floats, state: Floats, elapsed: float
) -> int:
    """The level that an estimate allows; see :meth:`.guard.Guard.judge`."""
    core, failsafe, kinds = guard.core[0], guard.failsafe[0], guard.kinds
    if NONE <= reversed < len(guard.inputs) and int(reversed) == reversed and int(reversed) != core.reversed:
        _reverse(guard, core.reversed)
        core.reversed = int(reversed)
        _reverse(guard, core.reversed)
    kinds[ESTIMATE].value = doubt
    kinds[ESTIMATE].worst = HOLDING if core.stabilised else RESTING
    _judge_actuators(guard, applied, elapsed)
    kinds[RANGE].value = _beyond(guard, state)
    level = judge_evidence(failsafe, kinds, min(elapsed, LONGEST))
    if without > 0.0 and level == 0:
        level = 1
    core.cause = _cause(guard, without) if level > 0 else NOTHING
    if level > 0:
        core.doubted, core.found = core.doubted + 1, core.cause
    if not core.act:
        level = 0
    core.level = level
    slow = core.slow_share
    core.share = slow if level > 0 else min(core.share + (1.0 - slow) * elapsed / RETURN, 1.0)
    core.tried = min(core.tried + (1.0 - TRIAL) * elapsed / RETURN, 1.0)
    if core.act and doubts_actuators(guard, failsafe.holding):
        core.tried = TRIAL
    return level


def _cause(guard: GuardMemory, without: float) -> int:
    """Why the loop is slowed, held or at rest: where the rig is counts more than what else is wrong."""
    failsafe, kinds = guard.failsafe[0], guard.kinds
    if kinds[RANGE].seconds >= failsafe.resting:
        return RANGE
    if failsafe.cause == NOTHING and guard.core[0].reversed != NONE:
        return INPUT
    is_missing = without > 0.0 and kinds[ESTIMATE].value <= MISSING
    if failsafe.cause == NOTHING or (failsafe.cause == ESTIMATE and is_missing):
        return SENSOR
    return failsafe.cause


def _reverse(guard: GuardMemory, which: int) -> None:
    """Give an input's past the other sign, commands and what acted."""
    if which != NONE:
        guard.inputs[which].acted, guard.inputs[which].common = -guard.inputs[which].acted, -guard.inputs[which].common
        _turn_past(guard, which)


def _turn_past(guard: GuardMemory, j: int) -> None:
    """Give the remembered commands of an input the other sign."""
    guard.inputs[j].sent, guard.inputs[j].common = -guard.inputs[j].sent, -guard.inputs[j].common
    for i in range(REMEMBERED):
        guard.sent[i * len(guard.inputs) + j] = -guard.sent[i * len(guard.inputs) + j]


def doubts_actuators(guard: GuardMemory, after: float) -> bool:
    """Whether actuators would be enough by themselves to stay at the level that is entered after a time [s], and a
    stabiliser could not go on with them.
    """
    return guard.kinds[ACTUATOR].worst >= RESTING and guard.kinds[ACTUATOR].seconds >= AGAIN * after


def may_stabilise(guard: GuardMemory) -> bool:
    """Whether a stabiliser may act while the loop rests: one whose inputs are not obeyed drives its rig away, and one
    that has fallen is not lifted.
    """
    after = guard.failsafe[0].resting
    has_fallen = guard.core[0].fallen and guard.kinds[RANGE].seconds >= AGAIN * after
    return not doubts_actuators(guard, after) and not has_fallen


def _beyond(guard: GuardMemory, state: Floats) -> float:
    """Evidence that the state is outside of its range."""
    states, most = guard.states, 0.0
    guard.core[0].fallen = False
    for a in range(len(states)):
        away = max(states[a].low - state[a], state[a] - states[a].high) / states[a].outside
        if states[a].stops * away > 1.0:
            guard.core[0].fallen = True
        if away > most:
            most = away
    return most


def _judge_actuators(guard: GuardMemory, applied: Floats, elapsed: float) -> None:
    """Find the evidence that actuators don't do what was commanded, and what it may lead to: a stabiliser goes on with
    all but those that do the opposite, since its rig can't rest, and trims them or sends them the opposite.
    """
    core, inputs, sent, replaced = guard.core[0], guard.inputs, guard.sent, guard.replaced
    share, m, count, most, unlike = min(elapsed / AVERAGE, 1.0), len(inputs), 0, 0.0, 0.0
    evidence = guard.kinds[ACTUATOR]
    for i in range(REMEMBERED):
        at = (core.row + REMEMBERED - i) % REMEMBERED
        replaced[at] += elapsed
        if replaced[at] > core.recent:
            break  # and so are all older ones
        count += 1
    for j in range(m):
        total, low, high = 0.0, math.inf, -math.inf
        for i in range(count):
            u = sent[(core.row + REMEMBERED - i) % REMEMBERED * m + j]
            total += u
            low, high = min(low, u), max(high, u)
        asked = total / count - inputs[j].middle
        away = abs(applied[j] - min(max(applied[j], low), high))
        if not away <= LARGEST_INPUT:
            away = asked = 0.0
        else:
            _follow_response(inputs[j], total / count, applied[j], share, min(elapsed / RESPONSE, 1.0))
            if core.stabilised and core.act:
                _turn_opposite(guard, j)
                _trim(guard, j, applied[j], low, high, elapsed)
        tolerance = inputs[j].tolerance
        near = abs(applied[j] + min(max(-applied[j], low), high)) <= tolerance
        is_off = away > (1.0 if inputs[j].opposes else FAR_OFF) * tolerance
        inputs[j].mirrored = inputs[j].mirrored + elapsed if is_off and near else 0.0
        inputs[j].acts = applied[j] if core.act and away > tolerance else math.nan
        inputs[j].missed += share * (away * away - inputs[j].missed)
        inputs[j].asked += share * (asked * asked - inputs[j].asked)
        most = max(most, away / tolerance)
        if inputs[j].asked > (SMALL * tolerance) * (SMALL * tolerance) and away > UNLIKE * abs(asked):
            unlike = max(unlike, inputs[j].missed / (UNLIKE * UNLIKE * inputs[j].asked))
    evidence.value = max(most, min(unlike, CLEAREST))
    evidence.worst = HOLDING if most > FAR else SLOWED
    for j in range(m):
        if inputs[j].opposes:
            evidence.value = max(evidence.value, TURNED)
        if not core.stabilised or _is_opposite(inputs[j]):
            evidence.worst = RESTING


def _is_opposite(item: GuardedInput) -> bool:
    """Whether an actuator does the opposite of its commands."""
    return item.common < -REVERSED * item.spread


def _turn_opposite(guard: GuardMemory, j: int) -> None:
    """Send an actuator that does the opposite the opposite, once for a fault, and only while the sensors agree with
    what it reports.
    """
    item, seconds, doubted = guard.inputs[j], guard.kinds[ACTUATOR].seconds, guard.kinds[ESTIMATE].seconds > 0.0
    item.turned_back = item.turned_back and seconds > 0.0
    opposite = (
        (_is_opposite(item) or item.mirrored > MIRRORED)
        and seconds >= guard.failsafe[0].slowed
        and not item.turned_back
    )
    if (item.opposes and doubted) or (opposite and not doubted):
        item.turned_back = item.opposes and not doubted
        item.opposes, item.trim, item.mirrored = not item.opposes, 0.0, 0.0
        _turn_past(guard, j)


def _trim(guard: GuardMemory, j: int, acted: float, low: float, high: float, elapsed: float) -> None:
    """Let the trim c of an actuator that is off its commands u, within low and high, make up for that, and be forgotten
    elsewhere: c' = -(acted - (u - c)) / TRIMMED, or c' = -c / TRIMMED.

    Integral action of the actuator's own loop, without what an actuator that does not answer would wind up.
    """
    item, room = guard.inputs[j], 0.5 * (guard.inputs[j].high - guard.inputs[j].low)
    still = item.power <= (SMALL * item.tolerance) * (SMALL * item.tolerance)
    off = abs(acted - min(max(acted, low), high)) > item.tolerance and guard.kinds[ESTIMATE].seconds == 0.0
    gap = item.trim
    if off and (still or abs(item.common) > ANSWERS * item.power):
        gap = acted - min(max(acted, low - item.trim), high - item.trim)
    item.trim = min(max(item.trim - min(elapsed / TRIMMED, 1.0) * gap, -room), room)


def _follow_response(item: GuardedInput, sent: float, acted: float, soon: float, share: float) -> None:
    """Take in a command and what acted: the moments of both. soon, share: of the means, and of the others."""
    a, b = sent - item.sent, acted - item.acted
    item.sent += soon * a
    item.acted += soon * b
    item.power += share * (a * a - item.power)
    item.spread += share * (a * a + b * b - item.spread)
    item.common += share * (2.0 * a * b - item.common)
