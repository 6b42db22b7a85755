"""Repetition: rows that come again, digit by digit, as where a record was glued to itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import runs_of

FEWEST = 100
"""Rows that come again, and rows later, from which a repetition is no chance."""
DISTINCT = 0.5
"""Share of different rows in a repetition: a rig that rests repeats itself, too."""


def repetitions(record: Record) -> Iterator[RecordFinding]:
    """The longest stretch of inputs and outputs that comes again. Noise does not, so that it is a copy."""
    rows = np.concatenate([record.input, record.output], axis=1)
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(number, kind="stable")
    later = np.diff(order)[np.diff(number[order]) == 0]
    later = later[later >= FEWEST]
    if not len(later):
        return
    lag = int(np.argmax(np.bincount(later)))
    firsts, lengths = runs_of((rows[lag:] == rows[:-lag]).all(axis=1))
    if not len(lengths):
        return
    first, length = (int(found[np.argmax(lengths)]) for found in (firsts, lengths))
    if length >= FEWEST and len(np.unique(number[first : first + length])) > DISTINCT * length:
        yield RecordFinding(
            kind="repetition", cost=0.79,
            words=f"samples {first + lag} to {first + lag + length - 1} are those from {first} on, digit by digit: "
            f"{length / len(rows):.0%} of the record tells nothing new",
            cure="was a record glued to itself? leave one of the two out (--part): errors of parameters would be too "
            "small",
        )  # fmt: skip
