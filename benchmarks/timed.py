"""A controller whose answers are timed."""

from __future__ import annotations

from time import perf_counter
from typing import Any

from hybrid_sysid_ros.control import Controller, MpcSolution


class Timed:
    """A controller that measures its calls."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.horizon, self.period = controller.horizon, controller.period
        self.seconds: list[float] = []

    def reset(self) -> None:
        """Forget the past."""
        self.controller.reset()

    def prepare(self, elapsed: float) -> None:
        """Not measured: it is done when the input is out."""
        self.controller.prepare(elapsed)

    def control(self, state: Any, disturbance: Any, previous_input: Any, preview: Any) -> MpcSolution:
        """Measure one call."""
        began = perf_counter()
        plan = self.controller.control(state, disturbance, previous_input, preview)
        self.seconds.append(perf_counter() - began)
        return plan
