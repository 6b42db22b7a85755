"""Plateau: an exact value that stays far longer than any other one, while what belongs to the signal moves on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import FEW, FROZEN, CheckedSignal, runs_of
from hybrid_sysid_ros.support.arrays import Array

LONGER, FEWEST, PIECES = 4.0, 20, 10
"""Length of a frozen plateau in that of the longest other one, fewest times that the signal changes, and pieces of a
record that are compared at least.
"""
MOVES, SEEN = 0.5, 4.0
"""Motion in a stretch, in the usual one of as many samples, from which a signal moves on; and usual motion in its
sensor's noise, from which that is seen.
"""


def plateau_findings(signal: CheckedSignal, signals: Sequence[CheckedSignal]) -> Iterator[RecordFinding]:
    """An input that stands still while the outputs move as if it did not, or an output that does while inputs move."""
    found = _longest(signal.values)
    if found is None:
        return
    start, stop = found
    others = [item for item in signals if item is not signal]
    inputs, outputs = ([item for item in others if item.is_input is kind] for kind in (True, False))
    if signal.is_input:
        frozen = not _rests(signal.values, start) and not any(np.ptp(item.values[start:stop]) for item in inputs)
        frozen = frozen and any(_moves_on(item, (start + stop) // 2, stop) for item in outputs)  # by then they settled
    else:
        frozen = any(_moves_on(item, start, stop) for item in inputs)
    if frozen:
        signal.spoilt[start:stop] = signal.explained = True
        signal.rough, lost = False, (stop - start) / len(signal.values)
        value, seconds = signal.shown(float(signal.values[start])), f"{(stop - start) * signal.period:.3g} s"
        moving = "outputs move as if it did not" if signal.is_input else "inputs move on"
        yield RecordFinding(
            kind="frozen", cost=min(0.79, 0.75 + 0.1 * lost),
            words=f"{signal.name} stays at {value} for {seconds} from {signal.at(start)} on, "
            f"{lost:.1%} of the record and far longer than ever else, while the {moving}",
            cure="leave that part out (--part), and look for a full buffer, a lost message or the sensor's cable",
        )  # fmt: skip


def _longest(values: Array) -> tuple[int, int] | None:
    """First and last but one sample of a plateau within a signal (samples,) that is far longer than all others."""
    starts, lengths = runs_of(np.append(False, np.diff(values) == 0.0))
    if not len(starts) or np.count_nonzero(np.diff(values)) < FEWEST:
        return None
    at = int(np.argmax(lengths))
    start, length = int(starts[at]) - 1, int(lengths[at]) + 1
    other = float(np.delete(lengths, at).max(initial=0)) + 1.0
    within = start > 0 and start + length < len(values) and values.min() < values[start] < values.max()
    long = length > max(FROZEN, LONGER * other, FEW * len(values))
    return (start, start + length) if within and long else None


def _rests(values: Array, start: int) -> bool:
    """Whether a command (samples,) rests by design: at zero, or where it begins or ends."""
    return values[start] in (0.0, values[0], values[-1])


def _moves_on(signal: CheckedSignal, start: int, stop: int) -> bool:
    """Whether a signal moves within a stretch as elsewhere, and not along a line, as what integrates does at rest."""
    length = min(stop - start, len(signal.values) // PIECES)
    within, elsewhere = list[float](), list[float]()
    for found, first, end in ((within, start, stop), (elsewhere, 0, start), (elsewhere, stop, len(signal.values))):
        found += [_bent(signal.values[k : k + length]) for k in range(first, end - length + 1, length)]
    usual = float(np.median(elsewhere)) if elsewhere else 0.0
    seen = usual > SEEN * float(np.hypot(signal.noise, signal.count))
    return seen and float(np.median(within)) > MOVES * usual


def _bent(values: Array) -> float:
    """Deviation of a signal (samples,) from a line."""
    at = np.arange(len(values))
    return float(np.std(values - np.polyval(np.polyfit(at, values, 1), at)))
