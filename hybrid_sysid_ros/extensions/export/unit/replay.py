"""Replay: what a loop in Python answered, period by period, and by how much a unit answers otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from hybrid_sysid_ros.control.mpc.calls import NOT_CONVERGED, SOLVED
from hybrid_sysid_ros.extensions.export.unit.built import PeriodAnswer
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.runtime.references import signal_of
from hybrid_sysid_ros.support.arrays import Array

WILD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0, 1e6, -1e6)
"""Readings and references that no rig has."""
UNKNOWN = (math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0)
"""Applied inputs that no rig has. A million moves an unstable rig to 1e60, where rounding decides the sign."""

ULP, ROUNDINGS = 2.0**-52, 8
"""Relative rounding of a reading, and how many are tried."""

FAULTS = ("flipped", "frozen", "outliers", "silent", "reversed", "stuck")
"""What the last sensor, all, the last actuator, and in the end all of them do in a loop with faults, one after the
other."""
SPELL = 200
"""Periods for each fault: the second half of these has it."""


class PeriodQuestion(NamedTuple):
    """What a loop is asked in a period. anew: it forgets the past first."""

    time: float
    outputs: Array
    applied: Array
    preview: Array
    anew: bool = False


class Stepped(Protocol):
    """A loop that is stepped."""

    def reset(self) -> None: ...
    def step(self, time: float, outputs: Array, applied: Array, preview: Array) -> PeriodAnswer: ...
    def prepare(self, elapsed: float) -> None: ...
    def sent(self, inputs: Array) -> None: ...


def recorded(
    rig: Rig, loop: PythonLoop, periods: int, *, seed: int = 0, faults: bool = False
) -> tuple[list[PeriodQuestion], list[PeriodAnswer]]:
    """A loop in Python with the simulated rig, along its default reference. faults: those of FAULTS happen."""
    plant, period = Plant(rig, seed=seed, bias=rig.bias), loop.estimator.period
    scales = np.array([display.scale for display in rig.display])
    reference, lead = signal_of(rig.reference, defaults(rig, "reference"), rig), loop.estimator.system.delay
    ahead: Array = lead + loop.controller.period * np.arange(1, loop.controller.horizon + 1, dtype=np.float64)
    questions, answers = [], []
    loop.reset()
    applied, sound = loop.command.copy(), plant.sensed()
    for k in range(periods):
        preview, outputs = scales * reference(plant.time + ahead), plant.sensed()
        fault = FAULTS[k // SPELL % len(FAULTS)] if faults and k % SPELL >= SPELL // 2 else ""
        if not fault:
            sound = outputs
        questions.append(PeriodQuestion(plant.time, _read(fault, k, outputs, sound), applied, preview, k == 0))
        answers.append(loop.step(*questions[-1][:4]))
        loop.prepare(period)
        applied = applied if fault == "stuck" else answers[-1].inputs
        acting = np.where(np.arange(len(applied)) == len(applied) - 1, -applied, applied)
        for _ in range(round(period / plant.step)):
            plant.advance(acting if fault == "reversed" else applied)
    return questions, answers


def _read(fault: str, k: int, outputs: Array, sound: Array) -> Array:
    """What sensors show in a fault in period k. sound: readings from before the fault."""
    last = np.arange(len(outputs)) == len(outputs) - 1
    match fault:
        case "flipped":
            return np.where(last, -outputs, outputs)
        case "frozen":
            return np.where(last, sound, outputs)
        case "outliers":
            return outputs + 100.0 * last * (k % 7 == 0)
        case "silent":
            return np.full_like(outputs, np.nan)
    return outputs


def odd(questions: Sequence[PeriodQuestion], count: int, *, period: float, seed: int = 1) -> Iterator[PeriodQuestion]:
    """Questions that a loop is not asked: jumps and gaps of time, late and repeated stamps, missing or wild numbers,
    and for a while each stamps that stand still, and no reference.
    """
    random, time, spell = np.random.default_rng(seed), 0.0, min(100, count // 8)
    for k in range(count):
        own = questions[k % len(questions)]
        kind = random.integers(0, 24) if k % 3 == 0 else 23
        stands = count // 4 <= k < count // 4 + spell
        time += 0.0 if stands else {0: 0.0, 1: -2.0 * period, 2: 2.0, 3: 0.4, 4: 1e4, 14: -3.0}.get(int(kind), period)
        outputs, applied, preview = own.outputs.copy(), own.applied.copy(), own.preview.copy()
        if count // 2 <= k < count // 2 + spell:
            preview[:] = np.nan
        if kind == 5:
            outputs[:] = np.nan
        for target, at, wild in ((outputs, (6, 7), WILD), (applied, (8, 9), UNKNOWN), (preview, (10,), WILD)):
            if kind in at:
                target.flat[random.integers(target.size)] = random.choice(wild)
        if kind == 11:
            outputs += random.normal(size=outputs.shape)
        stamp = {12: math.nan, 15: time + 100.0, 16: 1e300}.get(int(kind), time)
        yield PeriodQuestion(stamp, outputs, applied, preview, kind == 13 or k == 0)


def answers_of(
    loop: Stepped, questions: Sequence[PeriodQuestion], period: float, sent: Sequence[PeriodAnswer] = ()
) -> list[PeriodAnswer]:
    """What a loop answers. sent: what the rig got in place of its commands, so that one that differs has no sequel."""
    found = []
    for k, question in enumerate(questions):
        if question.anew:
            loop.reset()
        found.append(loop.step(*question[:4]))
        if sent and found[-1].status:  # there is a command
            loop.sent(sent[k].inputs)
        loop.prepare(period)
    return found


def rounded(loop: PythonLoop, questions: Sequence[PeriodQuestion], *, seed: int) -> list[PeriodAnswer]:
    """What a loop in Python answers to a recorded loop whose readings are moved by their rounding."""
    random = np.random.default_rng(seed)
    loop.command = questions[0].applied.copy()
    by = ULP * random.normal(size=(len(questions), len(questions[0].outputs)))
    moved = [asked._replace(outputs=asked.outputs * (1.0 + row)) for asked, row in zip(questions, by, strict=True)]
    return answers_of(loop, moved, loop.estimator.period)


def difference_from(
    loop: PythonLoop, questions: Sequence[PeriodQuestion], answers: Sequence[PeriodAnswer],
    found: Sequence[PeriodAnswer], *, tolerance: float,
) -> dict[str, float]:  # fmt: skip
    """:func:`largest_difference` of what was found from a recorded loop in Python.

    Where that iterates to convergence its problem may have several local solutions, between which rounding decides, in
    Python, too. While the difference exceeds the tolerance, the nearest of Python's answers to so many roundings of the
    readings counts, period by period.
    """
    nearest, difference, seed = list(answers), largest_difference(found, answers), 0
    while loop.iterates and not max(difference.values()) <= tolerance and seed < ROUNDINGS:
        for k, other in enumerate(rounded(loop, questions, seed=seed)):
            if np.max(np.abs(other.inputs - found[k].inputs)) < np.max(np.abs(nearest[k].inputs - found[k].inputs)):
                nearest[k] = other
        difference, seed = largest_difference(found, nearest), seed + 1
    return difference


def largest_difference(
    one: Sequence[PeriodAnswer], other: Sequence[PeriodAnswer], *, share: float = 1.0
) -> dict[str, float]:
    """The largest difference of each part, relative above 1; infinite where one is a number alone or has another
    status. share: of the periods whose inputs count, those that are nearest. Where it is less than all, rounding may
    also decide whether an iteration ends within its tolerance or with its last step.
    """
    found: dict[str, Any] = {}
    for name in PeriodAnswer._fields[1:]:
        a, b = (np.array([getattr(item, name) for item in items]) for items in (one, other))
        same = (a == b) | (np.isnan(a) & np.isnan(b))
        with np.errstate(invalid="ignore"):
            apart = np.where(same, 0.0, np.abs(a - b) / np.maximum(np.abs(b), 1.0))
        worst = np.sort(np.max(np.where(np.isnan(apart), np.inf, apart), axis=1, initial=0.0))
        found[name] = float(worst[math.ceil((share if name == "inputs" else 1.0) * len(worst)) - 1])
    ends = {NOT_CONVERGED: SOLVED} if share < 1.0 else {}
    unlike = sum(ends.get(a.status, a.status) != ends.get(b.status, b.status) for a, b in zip(one, other, strict=True))
    return found | {"status": math.inf if unlike else 0.0}
