"""Sampling: the step and the period at which a model is simulated and scored on records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hybrid_sysid_ros.support.errors import UserError

InputHandling = Literal["averaged", "sampled"]

LONGEST = 1e6
"""Period [s], eleven days: any record is too short for it."""

MOST_STEPS = 1000
"""Steps in a period; shorter steps are not more accurate, and they need memory."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a record is sampled for a simulation.

    step: integration step [s]. period: distance of the scored samples [s], a multiple of the step. input: "averaged"
    gives each step the mean of the record's input over it; "sampled" reads the input once every ``period`` and holds
    it, so that jumps of a reference arrive up to one period late.

    Raises UserError for other values, and for a period longer than :data:`LONGEST` or than :data:`MOST_STEPS` steps.
    """

    step: float = 0.005
    period: float = 0.05
    input: InputHandling = "averaged"

    def __post_init__(self) -> None:
        if self.input not in ("averaged", "sampled"):
            raise UserError(f"sampling: input {self.input!r} is unknown; choose averaged or sampled")
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

    @property
    def every(self) -> int:
        return max(1, round(self.period / self.step))
