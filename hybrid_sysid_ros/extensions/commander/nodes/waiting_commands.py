"""Waiting commands: what has passed and waits to be confirmed, and what waits for a condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.commands import Condition, Sentence
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast
from hybrid_sysid_ros.extensions.commander.language.interpreter import PATIENCE
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.runtime.set_points import SetPointRange
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

STILL, SHARE = 0.5, 0.01
"""Seconds in which outputs that move by less than this share of their set-points' range are still."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadyCommand:
    """A command that has passed."""

    sentence: Sentence
    plan: ReferencePlan
    forecast: Forecast
    since: float
    """When it passed, in steady time [s]."""
    words: str
    """What was understood, and what it comes to."""


@dataclass(kw_only=True, eq=False)
class AwaitedCommand:
    """What waits for a condition."""

    condition: Condition
    sentence: Sentence
    since: float
    """In steady time [s]."""
    begin: Array
    """Outputs then (outputs,), as they are shown."""
    seen: list[tuple[float, Array]] = field(default_factory=list)
    """Outputs of the last STILL seconds, by steady time."""

    def is_due(self, now: float, shown: Array, ranges: Sequence[SetPointRange], *, idle: bool) -> bool:
        """Whether the condition has come true, by the outputs (outputs,) as they are shown; idle: that no plan is
        carried out. Raises UserError where its time is over.
        """
        came = self._came(now, shown, ranges, idle=idle)
        if not came and now - self.since > max(self.condition.delay, PATIENCE):
            raise UserError(f"what it waits for did not come within {PATIENCE:g} s: the rest is left out")
        return came

    def _came(self, now: float, shown: Array, ranges: Sequence[SetPointRange], *, idle: bool) -> bool:
        if self.condition.delay:
            return now - self.since >= self.condition.delay
        if self.condition.output is not None:
            k, value, side = self.condition.output, self.condition.value, self.condition.side
            if side:
                return bool(side * (shown[k] - value) >= 0.0)
            near = 0.0 if self.sentence.is_stop else SHARE * (ranges[k].high - ranges[k].low)  # where a plan has led
            return bool((shown[k] - value) * (self.begin[k] - value) <= 0.0 or abs(shown[k] - value) < near)
        self.seen = [*((at, values) for at, values in self.seen if now - at < STILL), (now, shown)]
        if not idle or now - self.since < STILL:
            return False
        spread = np.ptp([values for _, values in self.seen], axis=0)
        slack = [SHARE * (item.high - item.low) if item.moves else np.inf for item in ranges]
        return bool((spread < np.array(slack)).all())
