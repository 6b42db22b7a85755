"""Parts of records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError

SHORTEST_PIECE = 20
"""Fewest scored samples of a piece of a record between two gaps: 1 s at the usual 50 ms."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """The part of each record that is used, as fractions of its duration."""

    start: float = 0.0
    stop: float = 1.0

    def of(self, record: Record, sampling: Sampling) -> Record:
        """This part of a record, cut at scored samples, so that all parts are sampled at the same instants, wherever
        they begin: an input that is read once a period shows a jump between samples up to a period late.

        Raises UserError where fewer than two samples are left.
        """
        return record.part(self.start, self.stop, every=scored_every(record, sampling))

    def first(self, record: Record, sampling: Sampling) -> int:
        """The index of the record's sample at which this part begins."""
        return record.cut(self.start, scored_every(record, sampling))

    @classmethod
    def parse(cls, text: str) -> Part:
        """A part from a text such as "0:0.5". Raises UserError for anything else."""
        try:
            start, stop = (float(value) for value in text.split(":"))
        except ValueError:
            raise UserError(f"part {text!r}: write START:STOP as fractions, such as 0:0.5") from None
        if not 0.0 <= start < stop <= 1.0:
            raise UserError(f"part {text!r}: needs 0 <= START < STOP <= 1")
        return cls(start=start, stop=stop)


def parts_of(records: Sequence[Record], part: Part | Sequence[Part], sampling: Sampling) -> list[Record]:
    """A part of each record; ``part`` is one for all or one for each. Raises UserError as :meth:`Part.of` does."""
    parts = [part] * len(records) if isinstance(part, Part) else part
    return [item.of(record, sampling) for record, item in zip(records, parts, strict=True)]


def check_apart(records: Sequence[Record], parts: Sequence[Part]) -> None:
    """Raise UserError where two records hold the same samples, which would count twice in every standard error."""
    seen = dict[str, list[tuple[Record, Part]]]()
    for record, part in zip(records, parts, strict=True):
        for other, its in (before := seen.setdefault(record.fingerprint, [])):
            if part.start < its.stop and its.start < part.stop:
                raise UserError(
                    f"records {other.name} and {record.name} hold the same samples, which would count twice: leave one "
                    "out, or give them parts that do not overlap"
                )
        before.append((record, part))


def without_gaps(records: Sequence[Record], sampling: Sampling) -> list[Record]:
    """The pieces of records between scored samples that were not measured, without pieces that are too short. Raises
    UserError where none is left.
    """
    found = [piece for record in records for piece in _pieces(record, scored_every(record, sampling))]
    if records and not found:
        raise UserError(f"{records[0].name}: no {SHORTEST_PIECE} scored samples without a gap: record it again")
    return found


def _pieces(record: Record, every: int) -> list[Record]:
    scored = np.ones(1, dtype=bool) if record.measured is None else record.measured[::every]
    if scored.all():
        return [record]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], scored, [False]]).astype(np.int8)))
    found = [(first, stop) for first, stop in edges.reshape(-1, 2).tolist() if stop - first >= SHORTEST_PIECE]
    cut = [record.between(first * every, min(stop * every, record.samples)) for first, stop in found]
    return [replace(piece, name=f"{record.name} piece {number}") for number, piece in enumerate(cut, 1)]


def scored_every(record: Record, sampling: Sampling) -> int:
    """Number of a record's samples from one scored sample to the next."""
    return max(1, round(sampling.period / record.sampling_time))
