"""Suspicion: for how long, and by how much, evidence has been beyond its threshold."""

from __future__ import annotations

CLEAREST = 10.0
"""Multiple of its threshold beyond which evidence counts no more: one wild number must not be enough."""
LONGEST = 0.05
"""Time [s] for which one update counts as evidence, however long ago the last one was."""


class Suspicion:
    """S+ = clip(S + (min(r, 10) - 1) dt, 0, most), in seconds; r: evidence as a multiple of its threshold, 0 below it.

    Evidence that stays at twice its threshold reaches one second after one second, clear evidence nine times sooner;
    without any, S falls by a second a second. What is below its threshold is none: it must not delay the way back.
    Source: Page (1954), Continuous inspection schemes, Biometrika 41.
    """

    def __init__(self, most: float) -> None:
        """most: where it stops to grow [s], so that it is forgotten within a known time."""
        self.seconds = 0.0
        self._most = most

    def add(self, evidence: float, elapsed: float) -> float:
        """Take in evidence of the last ``elapsed`` [s]; NaN counts as none. Returns S [s]."""
        clear = min(evidence, CLEAREST) if evidence > 1.0 else 0.0
        self.seconds = min(max(self.seconds + (clear - 1.0) * elapsed, 0.0), self._most)
        return self.seconds
