"""Plans: what people ask for, and what a simulation says of it, as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array

SHOWN = 400  # points of a simulated trajectory, at most


class PlanWriter:
    """Makes the messages of one rig's plans; none has a stamp: it begins when it comes."""

    def __init__(self, rig: Rig, signature: str) -> None:
        """signature: frame_id of the messages."""
        layout = SignalLayout(rig, rig.system)
        self.tracked = tracked_outputs(rig)
        """Which outputs have references (outputs,)."""
        self._signature = signature
        self._scales = np.array([display.scale for display in rig.display])
        self._referred = Slots([place for place, one in zip(layout.outputs, self.tracked, strict=True) if one])
        self._predicted = Slots([*layout.outputs, *layout.inputs])

    def set_point(self, plan: ReferencePlan) -> bytes:
        """References of the tracked outputs, in SI."""
        rows = (plan.values * self._scales)[:, self.tracked]
        return TrajectoryWriter(self._referred, _offsets(plan.times), self._signature).pack(0, rows.tolist())

    def forecast(self, forecast: Forecast) -> bytes:
        """Outputs and inputs as the simulation says."""
        loop = forecast.loop
        chosen = slice(None, None, max(1, -(-len(loop.time) // SHOWN)))
        rows = np.hstack([loop.outputs, loop.inputs])[chosen]
        return TrajectoryWriter(self._predicted, _offsets(loop.time[chosen]), self._signature).pack(0, rows.tolist())


def tracked_outputs(rig: Rig) -> NDArray[np.bool_]:
    """Which outputs have references (outputs,)."""
    return np.array([item.tracked for item in set_point_ranges(rig)])


def _offsets(times: Array) -> list[int]:
    """[ns], from [s]."""
    return [round(time * SECOND) for time in times.tolist()]
