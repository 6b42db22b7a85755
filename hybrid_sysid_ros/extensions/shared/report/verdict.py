"""Verdict: what a report shows, judged in a few sentences each, for somebody who has a minute.

The bounds of the grades are conventions of this project, which its guide to reports states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, isfinite

from hybrid_sysid_ros.extensions.shared.report.sections import IdentificationSection
from hybrid_sysid_ros.identification.validation.judgement import NOISE, ROUGHLY, WELL, noise_floors
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs import rig as rigs

CLOSE, FAR = 1.2, 2.0
"""Tracking errors, over those of the ideal loop, up to which a loop is good or fair."""
GOOD, FAIR, BAD = "good", "fair", "bad"


@dataclass(frozen=True)
class Judgement:
    """A grade, "" where there is nothing to judge by, and the sentences that say why."""

    grade: str
    words: str


def verdict(section: IdentificationSection, summary: RunSummary | None, driver: str) -> dict[str, Judgement]:
    """Judgements of the model, and of the loop if there was one. driver: who drove it, in a sentence."""
    found = {}
    if section.runs:
        found["model"] = _of_model(section)
    if summary is not None:
        found["tracking"], found["timing"] = _of_tracking(summary), _of_timing(summary)
        found["driver"] = _of_driver(summary, driver)
    return {name: judgement for name, judgement in found.items() if judgement.words}


def _of_model(section: IdentificationSection) -> Judgement:
    unseen = [run for run in section.runs if run.seen is False]
    runs, which = (unseen, "that it has not seen") if unseen else (section.runs, "that it may have been trained on")
    lowest = min(run.scores.r2 for run in runs)
    how, grade = ("well", GOOD) if lowest >= WELL else ("roughly", FAIR) if lowest >= ROUGHLY else ("badly", BAD)
    words = f"On the records {which} its free run diverges."
    if isfinite(lowest):
        least = floor(1e3 * lowest) / 1e3
        words = f"It predicts the records {which} {how} (R² of at least {least:.3f}, where 1 is perfect)."
        words += _against_noise(section)
    tests = [test for run in runs for test in run.tests.values()]
    if failed := sum(not test.passed for test in tests):
        words += (
            f" What is left is no pure noise: {failed} of {len(tests)} residual tests, in red below, find a pattern."
        )
    return Judgement(grade, words)


def _against_noise(section: IdentificationSection) -> str:
    """Errors of free runs beside what the sensors' noise alone would leave."""
    floors = noise_floors(rigs.load(section.model.rig), section.model.sampling.period)
    ratios = [run.scores.rmse / floors[run.output.name] for run in section.runs if floors.get(run.output.name)]
    if not ratios:
        return ""
    low, high = (f"{value:.2g}" if value < 100.0 else f"{value:.0f}" for value in (min(ratios), max(ratios)))
    range_ = low if low == high else f"{low} to {high}"
    most = max(ratios)
    much = "nothing but noise" if most <= 1.0 else "little but noise" if most <= NOISE else "not only noise"
    return f" Its error is {range_} times the noise of the sensors that the rig's file declares: {much}."


def _of_tracking(summary: RunSummary) -> Judgement:
    if summary.share is None:
        return Judgement("", "")
    words = f"The {summary.followed}."
    if summary.ratio is None:
        return Judgement(GOOD if summary.follows else BAD, words)
    words += (
        " In the ideal loop the exact MPC controls a plant that is its model, without noise or disturbance, and the "
        "rig's sensors read it."
    )
    if not summary.follows:
        return Judgement(BAD, words)
    if summary.ratio > CLOSE and summary.disturbed:
        return Judgement(FAIR, f"{words} This one was disturbed, which no model knows: {', '.join(summary.disturbed)}.")
    return Judgement(GOOD if summary.ratio <= CLOSE else FAIR if summary.ratio <= FAR else BAD, words)


def _of_timing(summary: RunSummary) -> Judgement:
    if summary.fast_enough is None:
        return Judgement("", "")
    if not summary.fast_enough:
        return Judgement(
            BAD,
            f"This machine was TOO SLOW, which spoils these numbers: {summary.missed} of {summary.measurements} "
            "commands came too late. Run the loop on one that is idle.",
        )
    half = f"half of the commands came within {summary.delay['p50']:.2g} ms, " if "p50" in summary.delay else ""
    words = f"This machine was fast enough: {half}{summary.missed} of {summary.measurements} came too late."
    return Judgement(GOOD, words)


def _of_driver(summary: RunSummary, driver: str) -> Judgement:
    words = [driver] if driver else []
    exact, network = (summary.layers.get(name, 0) for name in ("exact", "policy"))
    if replaced := summary.rejections and exact > network:
        answered, rejected = 100.0 * exact / (exact + network), 100.0 * sum(summary.rejections.values())
        words.append(
            f"But the exact MPC gave {answered:.3g} % of the answers: the online check refused {rejected:.2g} % of the "
            "plans that it saw, and after each the network is not asked until it agrees with the exact MPC for a while."
        )
    words.append(_left(summary.failsafe) if summary.failsafe else "It never had to slow down, hold or rest.")
    return Judgement(FAIR if summary.failsafe or replaced else GOOD, " ".join(words))


def _left(failsafe: Mapping[str, int]) -> str:
    times = ", ".join(f"{name}, {count} time{'' if count == 1 else 's'}" for name, count in failsafe.items())
    return f"Instead of driving it chose what is safer: {times}."
