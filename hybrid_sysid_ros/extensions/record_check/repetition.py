"""Repetition: a record whose beginning comes again, digit by digit, as where it was glued to itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding

FEWEST = 100
"""Rows that come again, and rows later, from which a repetition is no chance."""
DISTINCT = 0.5
"""Share of different rows in them: a rig that rests repeats itself, too."""


def repetition_findings(record: Record) -> Iterator[RecordFinding]:
    """The beginning of inputs and outputs where it comes again. Noise does not, and a periodic motion does not without
    noise, since it begins elsewhere; so it is a copy.
    """
    rows = np.concatenate([record.input, record.output], axis=1)
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    if record.samples < 2 * FEWEST or len(np.unique(number[:FEWEST])) < DISTINCT * FEWEST:
        return
    again = np.flatnonzero((sliding_window_view(number, FEWEST)[FEWEST:] == number[:FEWEST]).all(axis=1)) + FEWEST
    if len(again):
        first = int(again[0])
        same = np.append(number[first:] == number[:-first], False)
        last = first + int(np.argmin(same)) - 1
        yield RecordFinding(
            kind="repetition", cost=0.79,
            words=f"samples {first} to {last} are those from 0 on, digit by digit: "
            f"{(last - first + 1) / len(rows):.0%} of the record tells nothing new",
            cure="was a record glued to itself? leave one of the two out (--part): errors of parameters would be too "
            "small",
        )  # fmt: skip
