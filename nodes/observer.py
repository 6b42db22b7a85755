"""Observer: an estimator with what it reads out of measurements and the message that its estimate becomes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation import METHODS, StateEstimate
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.layout import Layout, Slots
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import CAMERA, estimator_tuning
from hybrid_sysid_ros.support.errors import UserError

SLACK = 0.05  # of its range, by which an input may be beyond its limits to be believed
WINDOW = 10.0  # s of innovations whose mean square is told
Measured = tuple[float, list[float]]
"""Time [s], and what was given then: outputs and applied inputs."""


class Observer:
    """All that depends on the model and on how it is trusted, made beside a loop that goes on with another one.

    given: what a measurement gave, outputs and applied inputs (p + m,), written by the caller before update().
    """

    def __init__(self, rig: Rig, model: Model, settings: Mapping[str, Any], signature: str) -> None:
        """Compiles. Raises UserError where parameters and model don't go together."""
        self.system = system = model.system
        layout = Layout(rig, system)
        limits = [(item.low, item.high, SLACK * (item.high - item.low)) for item in rig.actuators]
        bounds = [(low - slack, high + slack) for low, high, slack in limits]
        self.measured = Slots([*layout.outputs, *layout.inputs], bounds=bounds)
        self.camera = Slots([layout.outputs[0].ending(f"_{CAMERA}")])
        self.given = np.zeros(len(self.measured))
        self.outputs, self.applied = np.split(self.given, [len(layout.outputs)])
        self.tuning = estimator_tuning(settings, rig, system)
        self._further = layout.further
        self._settings = settings
        self._writer = JointWriter(Slots(layout.estimate(tuple(self.tuning.followed))), signature)
        self.begin()
        for k in range(1, 4):  # compiles, and has seen it all once before it matters
            self.pack(self.update((k - 1) / settings["rate"]), round(k * SECOND), blind=False)
        self.begin()

    def begin(self) -> None:
        """Begin anew, nothing estimated and nothing counted."""
        settings = self._settings
        kind, period = METHODS[settings["method"]], 1.0 / settings["rate"]
        self.filter = kind(self.system, self.tuning, period=period, latency=settings["latency"])
        self.innovations: deque[float] = deque(maxlen=round(WINDOW * settings["rate"]))
        self.parameters: Mapping[str, float] = {}

    def see(self, measured: Sequence[Measured]) -> None:
        """Take measurements that another one has answered, so as to go on where it is."""
        for time, given in measured:
            self.given[:] = given
            with suppress(UserError):  # nothing to hold on to yet
                self.note(self.update(time))

    def update(self, time: float) -> StateEstimate:
        """Estimate with what was given at a time [s]. Raises UserError where there is nothing to hold on to yet."""
        return self.filter.update(time, self.outputs, self.applied)

    def pack(self, estimate: StateEstimate, stamp: int, *, blind: bool) -> bytes:
        """The message of an estimate with its stamp [ns]; blind: it is a guess, on which nobody should act."""
        state, ahead, disturbance = estimate.state.tolist(), estimate.ahead.tolist(), estimate.disturbance.tolist()
        further: list[float] = []
        if self._further:
            outputs = output_of(self.system, estimate.state, self.applied + estimate.disturbance)
            further = outputs[self._further].tolist()
        parameters = estimate.parameters.tolist()
        numbers = [*state, *further, *disturbance, *ahead, *disturbance, *parameters]
        return self._writer.pack(stamp, [math.nan] * len(numbers) if blind else numbers)

    def note(self, estimate: StateEstimate) -> None:
        """What need not be done before the answer."""
        if math.isfinite(estimate.normalised_innovation):
            self.innovations.append(estimate.normalised_innovation)
        self.parameters = dict(zip(self.tuning.followed, estimate.parameters, strict=True))


class Still:
    """A sensor with noise that shows the same number for too long."""

    def __init__(self, *, after: int) -> None:
        self.seen = 0
        """Readings that were no news."""
        self._after, self._count, self._last = after, 0, math.nan

    def sees(self, reading: float) -> bool:
        """Whether a reading is no news."""
        self._count = self._count + 1 if reading == self._last else 0
        self._last = reading
        found = 0 < self._after <= self._count
        self.seen += found
        return found
