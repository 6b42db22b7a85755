"""Motion: the true positions of the simulated rig's joints at each of its steps, for a camera."""

from __future__ import annotations

from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig


class JointMotion:
    """Collects the positions of all joints that move; the velocity of a joint without a position is integrated."""

    def __init__(self, rig: Rig, steps: int, source: str) -> None:
        """steps: the rig's steps in a message; source: the frame_id of each message."""
        names = [item.name for item in rig.system.states]
        joints = {
            name: joint for name, joint in rig.joints.joints.items() if {joint.position, joint.velocity} & {*names}
        }
        self._positions = [names.index(joint.position) if joint.position in names else -1 for joint in joints.values()]
        self._velocities = [names.index(joint.velocity) if joint.velocity in names else -1 for joint in joints.values()]
        self._step, self._steps = rig.step, steps
        slots = Slots([SignalPlace(name, "position") for name in joints])
        spacing = [round(k * rig.step * SECOND) for k in range(1, steps + 1)]
        self._first, self._further = TrajectoryWriter(slots, [0], source), TrajectoryWriter(slots, spacing, source)
        self._sums = [0.0] * len(joints)
        self._rows: list[list[float]] = []

    def see(self, plant: Plant) -> None:
        """Add the positions after a step."""
        state = plant.state.tolist()
        for k, index in enumerate(self._positions):
            if index >= 0:
                self._sums[k] = state[index]
            elif self._velocities[k] >= 0:
                self._sums[k] += state[self._velocities[k]] * self._step
        self._rows.append(self._sums.copy())

    def message(self, stamp: int) -> bytes:
        """The message of the last steps, whose newest has a stamp [ns]; before the first step it has the initial
        positions alone.
        """
        rows, self._rows = self._rows or [self._sums.copy()], []
        if len(rows) < self._steps:
            return self._first.pack(stamp, rows[-1:])
        return self._further.pack(stamp - round(self._steps * self._step * SECOND), rows[-self._steps :])
