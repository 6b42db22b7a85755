"""An actuator: how a commanded input is limited."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hybrid_sysid_ros.rigs.sensor import Quantiser
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """Limits of an input, which need not be symmetric [unit of the input]; the system has its delay."""

    low: float
    high: float
    rate: float = math.inf
    """Fastest change [unit/s]."""
    quantiser: Quantiser | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise UserError(f"low is {self.low:g}, high {self.high:g}: two numbers are needed, low below high")
        if not self.rate > 0.0:
            raise UserError(f"rate is {self.rate:g}: it must be above 0")

    @property
    def rest(self) -> float:
        """The input without a command: zero, or the limit nearest to it."""
        return min(max(0.0, self.low), self.high)

    def bounded(self, value: float) -> float:
        """The input that acts for a command: within the limits, and ``rest`` for NaN."""
        if value != value:
            return self.rest
        value = min(max(value, self.low), self.high)
        if self.quantiser is not None:
            value = min(max(self.quantiser.read(value), self.low), self.high)
        return value

    def reached(self, value: float, before: float, seconds: float) -> float:
        """The input that acts ``seconds`` after the input ``before``: within the limits and the rate."""
        value, most = self.bounded(value), self.rate * seconds
        return min(max(value, before - most), before + most)
