"""The verdict of a mock-up: what was found, and a line for each criterion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.safety.certificate import binomial_bound
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns
from hybrid_sysid_ros.extensions.accuracy.setup import Setup
from hybrid_sysid_ros.extensions.accuracy.statistics import (
    Accuracy,
    ShotComparison,
    Verdict,
    needed,
    overall,
)
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

CONFIDENCE = 0.99
"""Of the bound on the share of plants that are kept."""
CLOSE = 0.95
"""Share of the misses that the tolerance must hold."""


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """A line of the verdict."""

    name: str
    kept: bool | None
    """None where the shots are too few to say."""
    words: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """All that a mock-up comes to."""

    setup: Setup
    models: Mapping[str, Model]
    """prior, gray box and structure, by what the page calls them."""
    errors: Mapping[str, Mapping[str, Mapping[str, float]]]
    """By model, record and output: errors over unseen experiments, as the output is shown."""
    ahead: str
    """What these errors are of."""
    runs: Mapping[str, MonteCarloRuns]
    """prior, simulated, live and uncertain shots."""
    loop: ClosedLoop | LoopRecord
    """The first of the live ones."""
    accuracy: Accuracy
    compared: Mapping[str, Mapping[str, Sequence[ShotComparison]]]
    """Live shots against those of the prior and of the model, by what they are of."""
    verdict: Sequence[Criterion]

    @property
    def model(self) -> Model:
        """The one that is judged."""
        return list(self.models.values())[-1]

    @property
    def fit(self) -> bool | None:
        """Whether all criteria are kept; None where the shots are too few to say."""
        kept = {line.kept for line in self.verdict}
        return False if False in kept else None if None in kept else True

    @property
    def conclusion(self) -> str:
        """The same in words."""
        return {True: "fit for use", False: "not fit for use", None: "too few shots to say"}[self.fit]


def judged(found: Found) -> Iterator[Criterion]:
    """The verdict's lines."""
    if found.errors:
        yield from _predicts(found)
    for of, comparisons in found.compared["simulated"].items():
        yield _agrees(of, comparisons, len(found.runs["live"].sound))
    for runs, who in ((found.runs["live"], "the rig"), (found.runs["uncertain"], "every uncertain plant")):
        yield _holds(runs, who)
        for window, most in found.setup.tolerance.items():
            yield _ends(runs, window, most, who)


def _predicts(found: Found) -> Iterator[Criterion]:
    before, after = found.errors["prior"], found.errors[found.model.structure]
    for name in next(iter(before.values())):
        ratios = [after[record][name] / max(before[record][name], 1e-300) for record in before]
        share = math.exp(float(np.mean(np.log(np.maximum(ratios, 1e-12)))))
        yield Criterion(
            name=f"the model predicts {name} better than what was known beforehand",
            kept=share < 1.0,
            words=f"errors {share:.3g} times the prior's ({found.ahead}, unseen experiments)",
        )


def _agrees(of: str, comparisons: Sequence[ShotComparison], live: int) -> Criterion:
    """The line of an output or of the inputs, by the quantity that speaks most against agreement."""
    verdict = overall(comparisons)
    worst = max(comparisons, key=lambda item: (item.verdict == verdict, item.bound / max(item.size, 1e-300)))
    share = 100.0 / max(worst.size, 1e-300)
    words = f"{worst.name} differs by {share * worst.difference:.2g} %, at most {share * worst.bound:.2g} %"
    if verdict is Verdict.CONTRADICTED:
        worst = min(comparisons, key=lambda item: item.probability)
        words = (
            f"{worst.name} differs by {worst.difference:.2g} {worst.unit}".rstrip()
            + f", {100.0 * worst.difference / max(worst.size, 1e-300):.2g} % (p {worst.probability:.2g})"
        )
    elif verdict is Verdict.OPEN:
        more = needed(worst, live)
        words += f"; some {more} live shots would show {100.0 * worst.matters:g} %" if more else ""
    return Criterion(
        name=f"{of}: the rig does what the model says",
        kept={Verdict.AGREES: True, Verdict.CONTRADICTED: False, Verdict.OPEN: None}[verdict],
        words=f"{words}; would have noticed {100.0 * worst.noticed / max(worst.size, 1e-300):.2g} %",
    )


def _holds(runs: MonteCarloRuns, who: str) -> Criterion:
    kept, count = int(runs.sound.all(axis=1).sum()), len(runs.sound)
    bound = binomial_bound(kept, count, 1.0 - CONFIDENCE)
    return Criterion(
        name=f"{who} is held, within its travel and validity",
        kept=kept == count,
        words=f"{kept} of {count}: a share of {bound:.3f} at least, with a confidence of {100 * CONFIDENCE:g} %",
    )


def _ends(runs: MonteCarloRuns, window: str, most: float, who: str) -> Criterion:
    names = list(runs.windows)
    unit, tracking_errors = runs.windows[window], np.abs(runs.tracking_error[:, names.index(window)])
    tracking_error = float(np.quantile(tracking_errors, CLOSE))
    return Criterion(
        name=f"{window} ends within {most:g} {unit}: {who}",
        kept=tracking_error <= most,
        words=f"{100 * CLOSE:g} % within {tracking_error:.3g} {unit}",
    )
