"""Sampling: the step and the period at which a model is simulated and scored on records."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from hybrid_sysid_ros.support.errors import UserError

InputHandling = Literal["averaged", "sampled", "interpolated", "auto"]

INITIAL = ("estimated", "first", "rest")
"""Ways to find the state at which a simulation of a record begins."""

LONGEST = 1e6
"""Period [s], eleven days: any record is too short for it."""

MOST_STEPS = 1000
"""Steps in a period; shorter steps are not more accurate, and they need memory."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a record is sampled for a simulation.

    step: integration step [s]. period: distance of the scored samples [s], a multiple of the step. input: "averaged"
    gives each step the mean of the record's input over it, where each sample holds until the next; "interpolated"
    joins the samples by lines instead (first-order hold), as a band-limited input is; "sampled" reads the input once
    every ``period`` and holds it, so that jumps of a reference arrive up to one period late. "auto" takes
    "interpolated" for a record whose input is band-limited and no finer than the step, else "averaged".

    initial: the state at which a simulation of a record begins. "estimated" from the first ``initial_samples`` scored
    samples, near what the record shows; "first" as the record shows it, only what it does not show being estimated;
    "rest" as its outputs are, without motion; or values by the names of states, such as "level=3.2, upper=4", the
    others being estimated. warm_up: first scored samples that no score counts.

    Raises UserError for other values, and for a period longer than :data:`LONGEST` or than :data:`MOST_STEPS` steps.
    """

    step: float = 0.005
    period: float = 0.05
    input: InputHandling = "averaged"
    initial: str = "estimated"
    initial_samples: int = 40
    warm_up: int = 0

    def __post_init__(self) -> None:
        if self.input not in get_args(InputHandling):
            raise UserError(f"sampling: input {self.input!r} is unknown; choose {', '.join(get_args(InputHandling))}")
        if not 0.0 < self.step <= self.period <= LONGEST:
            raise UserError(
                f"sampling: a step of {self.step} s and a period of {self.period} s: "
                f"needs 0 < step <= period <= {LONGEST:g} s"
            )
        if self.period > (MOST_STEPS + 0.5) * self.step:
            raise UserError(
                f"sampling: a step of {self.step} s makes more than {MOST_STEPS} of each period of {self.period} s; "
                "take a longer step"
            )
        if abs(self.every * self.step - self.period) > 1e-9:
            raise UserError(f"sampling: the period {self.period} s is no multiple of the step {self.step} s")
        if self.initial_samples < 1 or self.warm_up < 0:
            raise UserError(
                f"sampling: {self.initial_samples} samples for the start and {self.warm_up} that are not scored: give "
                "at least 1 (--initial-samples) and 0 (--warm-up)"
            )
        _ = self.given

    @property
    def given(self) -> dict[str, float]:
        """Given values of a first state by its states' names. Raises UserError for a text that says nothing."""
        if self.initial in INITIAL:
            return {}
        try:
            pairs = [item.split("=") for item in self.initial.split(",")]
            found = {name.strip(): float(value) for name, value in pairs}
        except ValueError:
            found = {}
        if not found or not all(math.isfinite(value) for value in found.values()):
            raise UserError(
                f"sampling: initial {self.initial!r} is unknown: write {', '.join(INITIAL)}, or values by the names of "
                "states, such as level=3.2,upper=4 (--initial)"
            )
        return found

    def at(self, period: float) -> Sampling:
        """The same with another period of the scored samples, whose start is estimated over the same time."""
        count = max(1, round(self.initial_samples * self.period / period))
        return replace(self, period=period, initial_samples=count)

    def following(self, period: float) -> Sampling:
        """The same where step and period are whole samples of a record, or whole parts of one; else with the nearest
        that are. period: of the samples [s].
        """
        if is_multiple(self.period, period) and is_multiple(max(self.step, period), min(self.step, period)):
            return self
        longer = self.step > period
        step = period * round(self.step / period) if longer else period / min(round(period / self.step), self.every)
        unit = max(step, period)
        return replace(self, step=step, period=unit * max(1, round(self.period / unit)))

    @property
    def every(self) -> int:
        return max(1, round(self.period / self.step))


def is_multiple(longer: float, shorter: float) -> bool:
    """Whether a time is a multiple of another one, but for a hundredth of that."""
    ratio = round(longer / shorter)
    return ratio >= 1 and abs(ratio * shorter - longer) <= 0.01 * shorter
