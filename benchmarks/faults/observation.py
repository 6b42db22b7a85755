"""Observation: what is seen and heard of a loop, and how well it tracks, stays inside and comes back."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise, takewhile
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults
from hybrid_sysid_ros.support.arrays import Array

SETTLED = 60
"""Measurements in a row that are answered in time: the loop is back."""
LATE = 0.004
"""By which an answer that came before the next measurement may be seen later than that [s]."""
INCOMPATIBLE = "somebody else"
"""frame_id of what the one who disturbs says: that is no command of the loop."""
REMEMBERED = 20_000
"""Measurements, and commands."""
PATIENCE = 30.0
"""Of all that is waited for [s]."""
WINDOW = 1.0
"""Over which tracking is judged [s]."""
ROOM = 2.0
"""Multiple of the largest usual tracking error, over WINDOW, within which a loop tracks."""
RESTRAINED = {"holding", "resting", "stopped", "disarmed"}
LONGEST_LOOK = 10.0
"""At a sound loop [s]."""
MOVING: Mapping[str, Mapping[str, Any]] = {
    "cam_beam": {"kind": "sine", "amplitude": [4.0], "frequency": 0.5},
    "flexible_joint": {"kind": "sine", "amplitude": [0.0, 30.0], "frequency": 0.5},
    "winged_cone": {"kind": "sine", "amplitude": [5.0, 0.0, 50.0, 0.0, 0.0], "frequency": 0.02},
    "drill_string": {"kind": "sine", "amplitude": [5.0, 0.0], "frequency": 0.1},
    "wheel_motor": {"kind": "sine", "amplitude": [150.0], "frequency": 0.5},
    "balancing_robot": {"kind": "sine", "amplitude": [0.3, 0.0, 0.0, 0.0, 0.0], "frequency": 0.2},
}
"""A reference of each rig that never rests, as parameters of the node."""


@dataclass(frozen=True)
class Said:
    """A status of the diagnostics that was not OK."""

    time: float
    name: str
    level: int
    message: str


@dataclass(frozen=True, eq=False)
class Sample:
    """A measurement as the rig sent it, before a fault."""

    time: float
    """Steady time [s]."""
    stamp: int
    outputs: Array
    """(p,) [SI]."""
    inputs: Array
    """(m,) that acted."""
    error: Array
    """(p,) of what is tracked, reference - output [SI]; NaN without a reference."""


class Observation:
    """The loop of a rig as it is seen from beside.

    tolerance: of the tracking error's rms over WINDOW (p,) [SI].
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.joint = next(iter(rig.joints.joints))
        layout = SignalLayout(rig, rig.system)
        self.outputs, self.inputs = layout.outputs, layout.inputs
        self._read, self._answer = Slots([*layout.outputs, *layout.inputs]), Slots(layout.inputs)
        self._wanted = Slots(layout.outputs)
        self._preview: Preview | None = None
        self.validator = MessageValidator(JointState, steady=time.monotonic_ns)  # by which bytes are read at once
        self._references = MessageValidator(JointTrajectory, steady=time.monotonic_ns)
        self.tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
        self.tolerance = np.full(len(self.outputs), math.inf)
        self.answered: dict[int, float] = {}
        """Steady time of the first command for each stamp [s]."""
        self.measured: deque[Sample] = deque(maxlen=REMEMBERED)
        self.commands: deque[tuple[float, Array]] = deque(maxlen=REMEMBERED)
        """Steady time and inputs (m,) of every command, but the stranger's."""
        self.states: deque[tuple[float, str]] = deque(maxlen=REMEMBERED)
        """Steady time and state of the loop, as the controller said it."""
        self.said: list[Said] = []
        self.values: dict[str, dict[str, str]] = {}
        """Newest values in the diagnostics of each node."""

    def _see(self, data: bytes) -> None:
        now, joints = time.monotonic(), self.validator.unpack(data)
        if joints is None:
            return
        outputs, inputs = np.split(np.array(self._read.read(joints.names, joints.lists)), [len(self.outputs)])
        error = np.full(len(outputs), math.nan)
        if self._preview is not None:
            error = np.where(self.tracked, self._preview.at(np.array([joints.stamp]))[0] - outputs, 0.0)
        self.measured.append(Sample(now, joints.stamp, outputs, inputs, error))

    def _refer(self, data: bytes) -> None:
        message = self._references.unpack(data)
        if message is not None and message.source != INCOMPATIBLE:
            found = Preview.of(message, self._references, self._wanted, self.tracked, message.stamp)
            self._preview = found or self._preview

    def _hear(self, data: bytes) -> None:
        now, joints = time.monotonic(), self.validator.unpack(data)
        if joints is None:
            return
        self.answered.setdefault(joints.stamp, now)
        if joints.source != INCOMPATIBLE:
            self.commands.append((now, np.array(self._answer.read(joints.names, joints.lists))))

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = status.name.partition(":")[0].rpartition("/")[2]
            self.values.setdefault(node, {}).update({value.key: value.value for value in status.values})
            if node == "controller" and "state" in self.values[node]:
                self.states.append((time.monotonic(), self.values[node]["state"]))
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            if level != int.from_bytes(DiagnosticStatus.OK, "little"):
                self.said.append(Said(time.monotonic(), status.name, level, status.message))

    def wait_until_back(self, since: float) -> float:
        """Time from ``since`` until the first of SETTLED measurements in a row that were answered before the next one;
        inf after PATIENCE [s].
        """
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            recent = [*takewhile(lambda entry: entry.time >= since, reversed(self.measured.copy()))][:0:-1]
            first, run = since, 0
            for sample, following in pairwise(recent):
                answer = self.answered.get(sample.stamp)
                in_time = answer is not None and answer <= following.time + LATE
                first, run = (first if run else sample.time, run + 1) if in_time else (since, 0)
                if run == SETTLED:
                    return first - since
            time.sleep(0.05)
        return float("inf")

    def since(self, begin: float, end: float = math.inf) -> list[Sample]:
        """Measurements from then until then [s of steady time]."""
        return [sample for sample in self.measured.copy() if begin <= sample.time < end]

    def tracking(self, begin: float) -> Array:
        """The tracking error (p,), rms over WINDOW [SI]; inf where nothing was measured."""
        errors = np.array([sample.error for sample in self.since(begin, begin + WINDOW)])
        return np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(len(self.outputs), math.inf)

    def learn(self) -> None:
        """Watch the sound loop, and take ROOM times its largest tracking error for the tolerance."""
        period = 1.0 / MOVING[self.rig.name]["frequency"]
        time.sleep(WINDOW)  # the way to the reference
        begin, count = time.monotonic(), math.ceil(min(period, LONGEST_LOOK) / WINDOW)
        time.sleep(count * WINDOW)
        windows = [self.tracking(begin + k * WINDOW) for k in range(count)]
        noise = np.array([sensor.scale * sensor.noise for sensor in self.rig.sensors])
        self.tolerance = np.where(self.tracked, ROOM * np.maximum(np.max(windows, axis=0), noise), math.inf)

    def bounded(self, since: float) -> bool:
        """Whether all inputs since then were numbers within the actuators' limits, applied or commanded."""
        (low, high), values = self.rig.limits, [sample.inputs for sample in self.since(since)]
        values += [inputs for moment, inputs in self.commands.copy() if moment >= since]
        found = np.array(values)
        return bool(np.all((found >= low - 1e-9) & (found <= high + 1e-9)))

    def left(self, since: float) -> float:
        """Steady time at which the rig left its travel or validity, as its sensors show it; inf if it did not."""
        bounds = [self.rig.travel, *([] if self.rig.validity is None else [self.rig.validity])]
        names = [item.name for item in self.rig.system.states]
        at = [(k, names.index(item.name)) for k, item in enumerate(self.rig.system.outputs) if item.name in names]
        for sample in self.since(since):
            for low, high in bounds:
                if not all(low[state] <= sample.outputs[k] <= high[state] for k, state in at):
                    return sample.time
        return math.inf

    def restrained(self, since: float) -> float:
        """Steady time at which the loop was first held or at rest; inf if it never was."""
        return next(
            (moment for moment, state in self.states.copy() if moment >= since and state in RESTRAINED), math.inf
        )
