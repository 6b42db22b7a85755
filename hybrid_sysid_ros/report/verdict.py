"""Verdict: what a report shows, judged in a sentence each, for somebody who has a minute."""

from __future__ import annotations

from math import floor, isfinite

from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.report.sections import IdentificationSection

WELL, ROUGHLY = 0.9, 0.5
"""Least shares of a record's variance that a model explains to predict it well, or roughly."""


def verdict(section: IdentificationSection, summary: RunSummary | None, driver: str) -> dict[str, str]:
    """Sentences on the model and on the loop, if there was one. driver: who drove it, in a sentence."""
    found = {}
    if section.runs:
        found["model"] = _of_model(section)
    if summary is not None:
        parts = [driver, summary.followed and f"The {summary.followed}."]
        parts += [_left(summary) if summary.failsafe else "It never had to slow down, hold or rest."]
        if summary.fast_enough is False:
            parts.append("This machine was TOO SLOW, which spoils these numbers: run the loop on one that is idle.")
        found["loop"] = " ".join(filter(None, parts))
    return found


def _of_model(section: IdentificationSection) -> str:
    unseen = [run for run in section.runs if run.seen is False]
    runs, which = (unseen, "that it has not seen") if unseen else (section.runs, "that it may have been trained on")
    lowest = min(run.scores.r2 for run in runs)
    how = "well" if lowest >= WELL else "roughly" if lowest >= ROUGHLY else "badly"
    words = f"On the records {which} its free run diverges."
    if isfinite(lowest):
        least = floor(1e3 * lowest) / 1e3
        words = f"It predicts the records {which} {how} (R² of at least {least:.3f}, where 1 is perfect)."
    tests = [test for run in runs for test in run.tests.values()]
    if failed := sum(not test.passed for test in tests):
        words += (
            f" What is left is no pure noise: {failed} of {len(tests)} residual tests, in red below, find a pattern."
        )
    return words


def _left(summary: RunSummary) -> str:
    times = ", ".join(f"{name}, {count} time{'' if count == 1 else 's'}" for name, count in summary.failsafe.items())
    return f"Instead of driving it chose what is safer: {times}."
