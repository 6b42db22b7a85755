"""Set-points: what may be asked of a rig's outputs while it runs, whoever asks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults

REACH = 2.0
"""Times the rig's own amplitude of references, within which set-points are."""


@dataclass(frozen=True, kw_only=True)
class Output:
    """An output as it is shown, and where its set-points may be; NaN where it is not tracked."""

    name: str
    unit: str
    scale: float
    """SI per unit."""
    tracked: bool
    low: float = math.nan
    high: float = math.nan

    @property
    def moves(self) -> bool:
        """Whether it may be sent anywhere: one whose references have no amplitude is weighed, but belongs at 0."""
        return self.high > self.low


def outputs_of(rig: Rig) -> tuple[Output, ...]:
    """The outputs of a rig: set-points lie within its travel, less a margin, and within REACH of its own amplitude."""
    weights = defaults(rig, "controller")["output_weight"]
    amplitudes = defaults(rig, "reference")["amplitude"]
    found = []
    for item, display, weight, amplitude, reach in zip(
        rig.system.outputs, rig.display, weights, amplitudes, rig.reach.T, strict=True
    ):
        low = high = math.nan
        if weight > 0.0:
            low, high = sorted((reach / display.scale).tolist())
            most = REACH * abs(amplitude)
            low, high = max(low, -most), min(high, most)
        found.append(
            Output(name=item.name, unit=display.unit, scale=display.scale, tracked=weight > 0.0, low=low, high=high)
        )
    return tuple(found)
