"""Set-points: the range in which each output of a rig may be asked to be."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults

REACH = 2.0
"""Set-points lie within this many times the amplitude of the rig's own references."""


@dataclass(frozen=True, kw_only=True)
class SetPointRange:
    """The range of an output's set-points in its display unit; NaN if it is not tracked."""

    name: str
    unit: str
    scale: float
    """SI per unit."""
    tracked: bool
    low: float = math.nan
    high: float = math.nan

    @property
    def moves(self) -> bool:
        """Whether the output has a range; one whose references have no amplitude is weighted but stays at 0."""
        return self.high > self.low


def set_point_ranges(rig: Rig) -> tuple[SetPointRange, ...]:
    """Set-point ranges of a rig's outputs: within its travel less a margin, and within REACH times its amplitude."""
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
            SetPointRange(
                name=item.name, unit=display.unit, scale=display.scale, tracked=weight > 0.0, low=low, high=high
            )
        )
    return tuple(found)
