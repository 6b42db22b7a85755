"""Motion ahead: a joint followed by a camera's frames alone, and where it will be by the inputs on the way.

How much the offset of an input drifts is the rig's tuning for a loop, which had better believe too much than too
little; seconds ahead that costs dearly, where the joint sticks and tells nothing of the offset. So several shares of
that drift are followed side by side, and the one whose earlier predictions were the likeliest, seen from the frames
that came, is believed (prequential choice: Dawid 1984, Journal of the Royal Statistical Society A 147(2)).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, StateEstimate
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.runtime.configuration import CAMERA
from hybrid_sysid_ros.support.arrays import Array

DRIFTS = (1.0, 0.1, 0.0)
"""Shares of the tuning's drift that are followed; the first is believed until another one has done better."""
MEMBERS = 32
"""Motions that make a band."""


class MotionAhead:
    """A joint followed by one share of the drift."""

    def __init__(self, system: System, tuning: Tuning, *, drift: float, step: float, seed: int) -> None:
        """step: of the inputs [s]. seed: of the motions that make the band."""
        self.drift, self.step, self.system = drift, step, system
        self.tuning = replace(tuning, disturbance_noise=tuple(drift * item for item in tuning.disturbance_noise))
        self.estimate: StateEstimate | None = None
        self.likelihood = 0.0
        """Of the predictions that came true so far, logarithm of the density, summed."""
        self._filter = ExtendedKalmanFilter(system, self.tuning, period=step)
        self._random = np.random.default_rng(seed)
        self._unmeasured = np.full(len(system.outputs), np.nan)
        self._expected: dict[int, tuple[float, float]] = {}

    def move(self, time: float, applied: Array) -> None:
        """Go on to a time [s] under the mean inputs (inputs,) since the step before."""
        if self.estimate is not None:
            self.estimate = self._filter.update(time, self._unmeasured, applied)

    def see(self, frame: int, time: float, position: float) -> None:
        """Take a frame that shows the joint, and judge by it what was expected of it."""
        self.estimate = self._filter.correct(time, position, CAMERA)
        if frame in self._expected:
            expected, deviation = self._expected.pop(frame)
            self.likelihood -= 0.5 * ((position - expected) / deviation) ** 2 + math.log(deviation)

    def expect(self, frame: int, position: float, deviation: float) -> None:
        """Remember what a frame is expected to show; the frame itself is noisy, too."""
        self._expected[frame] = position, math.hypot(deviation, self.tuning.channels[CAMERA].noise)

    def run_on(self, inputs: Array, past: int) -> tuple[Array, Array]:
        """States (samples, states) from the estimate on and their standard deviations.

        inputs: (past + samples - 1, inputs), the first ``past`` of which were before.

        The motion is run as the estimate says and MEMBERS times as it may be: states and offset of the input by their
        covariance, the offset drifting and the input as noisy as the tuning says.
        """
        if self.estimate is None:
            raise ValueError("nothing was seen yet")
        system, tuning, step, estimate, random = self.system, self.tuning, self.step, self.estimate, self._random
        n, m, count = len(system.states), len(system.inputs), 1 + MEMBERS
        size, steps = n + m, len(inputs)
        values, vectors = np.linalg.eigh(estimate.covariance[:size, :size])
        spread = random.standard_normal((count, size)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        spread[0] = 0.0
        begins = estimate.state + spread[:, :n]
        drift = np.sqrt(step) * np.array(tuning.disturbance_noise) * random.standard_normal((count, steps, m))
        rough = np.array(tuning.input_noise) / np.sqrt(step) * random.standard_normal((count, steps, m))
        drift[0] = rough[0] = 0.0
        drift[:, :past] = rough[:, :past] = 0.0
        offset = estimate.disturbance + spread[:, None, n:] + np.cumsum(drift, axis=1)
        given = (inputs + offset + rough).reshape(count * steps, m)
        samples = 1 + steps - past
        starts = np.array([[j * steps, j * steps + past, samples, j * samples] for j in range(count)])
        states, _ = rollouts(system, starts, begins, np.ascontiguousarray(given), step=step)
        paths = states.reshape(count, samples, n)
        return paths[0], np.sqrt(np.mean((paths[1:] - paths[0]) ** 2, axis=0))
