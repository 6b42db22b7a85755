"""How a model meets records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hybrid_sysid_ros.errors import UserError

InputHandling = Literal["averaged", "sampled"]


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How records meet the simulation.

    step: integration step [s]. period: distance of the scored samples [s], a multiple of the step. input: "averaged"
    gives each step the mean of the record's input over it; "sampled" reads the input once every ``period`` and holds
    it, as the lecture does: reference jumps then arrive up to one period late.
    """

    step: float = 0.005
    period: float = 0.05
    input: InputHandling = "averaged"

    def __post_init__(self) -> None:
        if self.input not in ("averaged", "sampled"):
            raise UserError(f"sampling: input {self.input!r} is unknown; choose averaged or sampled")
        if self.step <= 0 or self.period <= 0 or abs(self.every * self.step - self.period) > 1e-9:
            raise UserError(f"sampling: the period {self.period} s is no multiple of the step {self.step} s")

    @property
    def every(self) -> int:
        return max(1, round(self.period / self.step))
