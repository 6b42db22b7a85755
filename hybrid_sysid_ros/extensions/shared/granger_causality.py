"""Granger causality: inputs of a record that answer its outputs."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lstsq
from scipy.stats import f

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

ORDER, OWN, CERTAIN, ENOUGH, JUMP = 12, 60, 1e-4, 20_000, 5.0
"""Samples of an output's past and of an input's own, level of the test for feedback, samples of a record to which it is
applied, and how many times as far as usual an input moves in a jump. An input's own past is longer, since the output
remembers it, too.
"""
ANSWERED = 0.05
"""Least share of an input's news that answers an output: less is what an output's memory adds to a smooth input's own
past, whose sensor is noisy.
"""
MOST_NEAR = 0.8
"""Share of the samples near jumps from which these have a say all the same."""


def feedbacks_of(record: Record, rig: Rig) -> list[str]:
    """Which inputs answer which outputs, in words: under feedback alone an output's past foretells an input beside the
    input's own past (Granger 1969, Econometrica 37(3)).
    """
    return [
        f"{item.name} answers {output.name}"
        for item, u in zip(rig.system.inputs, record.input.T, strict=True)
        for output, y in zip(rig.system.outputs, record.output.T, strict=True)
        if leads(y, u)
    ]


def leads(output: Array, given: Array) -> bool:
    """Whether the past of an output (samples,) foretells an input (samples,) beside the input's own past.

    Samples in which the input jumps have no say, for an output foretells when the next step of an experiment is due,
    nor the next ones, in which it shows a noisy input's new level. In an input that only jumps, jumps have it alone,
    beside the levels before and what those do to the output.
    """
    y, u = output[:ENOUGH], given[:ENOUGH]
    if np.ptp(y) == 0.0 or np.ptp(u) == 0.0:
        return False
    y, u = ((values - values.mean()) / values.std() for values in (y, u))
    moves = np.abs(np.diff(u, prepend=u[0]))
    jumps = moves > JUMP * np.median(moves)
    if moves[~jumps].any():
        near = np.convolve(jumps, np.ones(ORDER + 1))[: len(u)] > 0.5
        levels, own, rows = u, OWN, np.flatnonzero(~(jumps if near.mean() > MOST_NEAR else near))
        rows = chosen = rows[rows >= OWN]
    else:  # a jump may take some samples, where means of a step are recorded
        levels, own, y = u[jumps & ~np.append(jumps[1:], False)], ORDER, _innovations(y, u)
        rows = np.flatnonzero(jumps & ~np.append(False, jumps[:-1]))[ORDER : len(levels)]
        chosen = np.flatnonzero(rows >= OWN) + ORDER
        rows = rows[rows >= OWN]
    free = len(rows) - own - ORDER - 1
    if free < 2 * ORDER:
        return False
    past = np.column_stack([_past(levels, own)[chosen - own], np.ones(len(rows))])
    wider = np.hstack([past, _past(y, ORDER)[rows - ORDER]])
    squares = [
        float(np.sum((levels[chosen] - table @ lstsq(table, levels[chosen])[0]) ** 2)) for table in (past, wider)
    ]
    least = 1e-18 * len(u)  # an input that its own past foretells to the last digit
    answered = squares[0] / squares[1] - 1.0 if squares[1] > least else 0.0
    return answered > ANSWERED and answered * free / ORDER > f.isf(CERTAIN, ORDER, free)


def _past(values: Array, length: int) -> Array:
    """So many samples before each one from that number on, (samples - length, length)."""
    return np.lib.stride_tricks.sliding_window_view(values[:-1], length)


def _innovations(output: Array, given: Array) -> Array:
    """What the past of an output and of an input, and the input now, do not say of the output, (samples,)."""
    table = np.column_stack(
        [_past(given, OWN), given[OWN:], _past(output, ORDER)[OWN - ORDER :], np.ones(len(given) - OWN)]
    )
    found = np.zeros(len(output))
    found[OWN:] = output[OWN:] - table @ lstsq(table, output[OWN:])[0]
    return found
