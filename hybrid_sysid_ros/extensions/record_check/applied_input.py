"""Applied input: whether the outputs answer an input as it was recorded, held or cut off, or another one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.alignment import CLEAR, best_alignment, changes, time_of_change
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs, is_guessed
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

UNRELATED = 0.3
"""Correlation of a held input's neighbouring levels below which they are drawn, and no faster signal's samples."""
LEVELS, REPEATED, NEAR = 20, 4, 0.01
"""Fewest levels of an input, and how many times as often as any other one an end of them is there, from which they may
be cut off there, unless that end, within a share of the span, is the actuator's.
"""
TRIED, HIGHER, LEFT = 0.1, 0.05, (0.85, 0.95)
"""Height by which levels are tried to go on, and the least one that counts, in the span; and squared errors that it may
leave, in that of the physics, and in what another scale of these leaves.
"""


def of_held_input(item: RecordFinding, record: Record, rig: Rig, expected: Array | None) -> RecordFinding | None:
    """What is left of a finding by the physics, (samples, outputs): a held input is no fault where the outputs answer
    it at its times; where nobody can tell, it is a remark, and none where its levels are drawn at random, as steps of
    an experiment are.
    """
    if not item.samples:
        return item
    acts = None if expected is None else acts_as_held(record, expected, item.samples)
    if acts is False and not is_guessed(rig):
        return item
    values = record.input[:, [known.name for known in rig.system.inputs].index(item.signal)]
    levels = values[np.flatnonzero(np.diff(values))]
    drawn = abs(float(np.corrcoef(levels[1:], levels[:-1])[0, 1])) < UNRELATED
    return None if acts or drawn else replace(item, cost=0.2)


def acts_as_held(record: Record, expected: Array, every: int) -> bool | None:
    """Whether an output answers a held input at its times; None where the rig's physics (samples, outputs) can't tell.

    A recorder that holds makes an input late, by half of the time that it holds it: all outputs answer earlier.
    """
    acts = None
    for measured, physics in zip(record.output.T, expected.T, strict=True):
        apart = time_of_change(physics)
        found = best_alignment(measured, physics, np.ones(record.samples, dtype=bool), apart, 8 * apart + every)
        if found.correlation > CLEAR:
            acts = acts or found.lag > -max(0.25 * every, 1.0)
    return acts


def levels_cut_off(
    record: Record, rig: Rig, signals: Sequence[CheckedSignal], expected: Array
) -> Iterator[RecordFinding]:
    """Inputs whose levels are cut off at an end, beyond which the outputs answer them. expected: (samples, outputs)."""
    for column, signal in enumerate(item for item in signals if item.is_input):
        ends = np.zeros(record.samples) if signal.spoilt.any() else _levels_at_ends(signal)
        height = _height_beyond(record, rig, column, ends, expected) if ends.any() else 0.0
        if height > HIGHER * signal.span:
            places = " and ".join(signal.shown(end) for end in np.unique(signal.values[ends != 0.0]).tolist())
            yield RecordFinding(
                kind="clipped", cost=0.75,
                words=f"{signal.name} stands at exactly {places} in {np.mean(ends != 0.0):.0%} of the samples, and the "
                f"outputs move as if it had gone some {signal.shown(height)} farther there",
                cure="enlarge the range of its converter, or record the command; leave those parts out (--part)",
            )  # fmt: skip


def _levels_at_ends(signal: CheckedSignal) -> Array:
    """Where an input stands at an end that its levels, which else are all others, have again and again: 1 at the
    highest, -1 at the lowest, (samples,).
    """
    y, found = signal.values, np.zeros(len(signal.values))
    levels = y[np.concatenate([[0], np.flatnonzero(np.diff(y)) + 1])]
    at = {way: _is_at(end, levels) for way, end in ((1.0, y.max()), (-1.0, y.min()))}
    others = levels[~(at[1.0] | at[-1.0])]
    most = int(np.unique(others, return_counts=True)[1].max(initial=1))
    for way, end in ((1.0, y.max()), (-1.0, y.min())):
        often = np.sum(at[way]) > REPEATED * most
        real = any(abs(end - limit) < NEAR * signal.span for limit in signal.limits)
        if len(levels) > LEVELS and often and not real:
            found[_is_at(end, y)] = way
    return found


def _is_at(end: float, values: Array) -> NDArray[np.bool_]:
    return np.asarray(np.abs(values - end) <= 1e-6 * np.ptp(values))


def _height_beyond(record: Record, rig: Rig, column: int, ends: Array, expected: Array) -> float:
    """How much farther an input went at its ends, by the output that says it best: least squares of what the physics
    do not explain, by what a higher input moves. 0 where that explains little, or less than another scale.
    """
    pushed, height = record.input.copy(), TRIED * float(np.ptp(record.input[:, column]))
    pushed[:, column] += height * ends
    farther = expected_outputs(replace(record, input=pushed), rig)
    best, found = LEFT[0], 0.0
    for k in range(expected.shape[1] if farther is not None else 0):
        assert farther is not None
        apart = time_of_change(expected[:, k])
        error, physics, more = (
            changes(values[:, k], apart) for values in (record.output - expected, expected, farther - expected)
        )
        (_, scaled), (factor, left) = (_explained(error, cause) for cause in (physics, more))
        if left < min(best, LEFT[1] * scaled):
            best, found = left, factor * height
    return found


def _explained(error: Array, cause: Array) -> tuple[float, float]:
    """The factor of a cause that explains an error best, and the squares that it leaves, in those of the error."""
    factor = float(error @ cause) / max(float(cause @ cause), 1e-300)
    return factor, float(np.sum((error - factor * cause) ** 2)) / max(float(error @ error), 1e-300)
