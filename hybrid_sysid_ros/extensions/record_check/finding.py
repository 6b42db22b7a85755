"""A finding: what is wrong with a record, what it costs, and its cure."""

from __future__ import annotations

from dataclasses import dataclass

BLOCKS = 0.8
"""Cost from which a fit would be worth nothing."""


@dataclass(frozen=True, kw_only=True)
class RecordFinding:
    """One fault of a record, or what it can't tell."""

    kind: str
    """In a word or two: delay, sign, frozen, ..."""
    cost: float
    """From 0 (worth knowing) to 1 (nothing can be learned)."""
    words: str
    """What was seen, where."""
    cure: str
    samples: int = 0
    """Of a held input, the samples between its changes."""
    signal: str = ""
    """Of a held input, its name."""

    @property
    def blocks(self) -> bool:
        """Whether a fit would be worth nothing."""
        return self.cost >= BLOCKS

    def __str__(self) -> str:
        return f"{self.kind}: {self.words}; {self.cure}"


def sentence(findings: list[RecordFinding]) -> str:
    """What to make of a record, in a sentence."""
    if not findings:
        return "no fault is seen; go on to identify"
    worst, more = findings[0], len(findings) - 1
    others = f", and {more} more" if more else ""
    if worst.blocks:
        return f"a fit would be worth nothing before this is cured: {worst.kind}{others}"
    return f"usable with care: {worst.kind}{others}"
