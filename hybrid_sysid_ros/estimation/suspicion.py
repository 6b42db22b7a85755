"""Suspicion: for how long, and by how much, evidence has been beyond its threshold."""

from __future__ import annotations

CLEAREST = 10.0
"""Multiple of its threshold beyond which evidence counts no more: one wild number must not be enough."""
LONGEST = 0.05
"""Time [s] for which one update counts as evidence, however long ago the last one was."""


def suspicion(seconds: float, evidence: float, elapsed: float, most: float) -> float:
    """S+ = clip(S + (min(r, 10) - 1) dt, 0, most), in seconds; r: evidence as a multiple of its threshold, 0 below it
    and where it is NaN.

    Evidence that stays at twice its threshold reaches one second after one second, clear evidence nine times sooner;
    without any, S falls by a second a second. What is below its threshold is none: it must not delay the way back. At
    most it stops to grow, so that it is forgotten within a known time.
    Source: Page (1954), Continuous inspection schemes, Biometrika 41.
    """
    clear = min(evidence, CLEAREST) if evidence > 1.0 else 0.0
    return min(max(seconds + (clear - 1.0) * elapsed, 0.0), most)
