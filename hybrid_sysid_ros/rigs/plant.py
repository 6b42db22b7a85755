"""A rig simulated: its equation at a fine step, with the drive's limit and the sensor's faults."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import compiled
from hybrid_sysid_ros.core.rollout import advance
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import Filter

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What the sensor shows: time [s], position [rad] and the position behind the rig's filter [rad]."""

    time: float
    position: float
    filtered: float


class Plant:
    """The rig's equation integrated at ``rig.step`` (1 kHz), driven by a bounded input that never is NaN."""

    def __init__(self, rig: Rig, *, seed: int, bias: float = 0.0, noisy: bool = True) -> None:
        """bias: constant added to the drive [V], a disturbance that no model knows. noisy: hum, noise and counts."""
        self.rig = rig
        self.bias = bias
        self.noisy = noisy
        self._random = np.random.default_rng(seed)
        self._phase = self._random.uniform(0, 2 * np.pi)
        self._step = compiled(rig.system).step
        self._parameters = rig.system.values
        self._weights = rig.system.weights
        delay = rig.system.delay / rig.step
        self._whole, self._part = int(delay), delay % 1.0
        self._filter = Filter(rig.sensor, rig.step)
        self._following = np.zeros(len(rig.system.states))
        self._drive = np.zeros(1)
        self.reset(np.zeros(len(rig.system.states)))

    def reset(self, state: Array, *, drive: float = 0.0) -> None:
        """Start again at time 0 from a state (states,), the drive having stood at ``drive`` [V]."""
        self._ticks = 0
        self.state = np.array(state, dtype=float)
        self._past = deque([drive] * (self._whole + 2), maxlen=self._whole + 2)
        self._filter.reset(float(self.state[0]))
        self._read()

    def change(self, **parameters: float) -> None:
        """From here on parameters of the equation have other values, as friction when it warms up; the delay stays."""
        names = [item.name for item in self.rig.system.parameters]
        for name, value in parameters.items():
            self._parameters[names.index(name)] = value

    @property
    def time(self) -> float:
        return self._ticks * self.rig.step

    def advance(self, drive: float) -> None:
        """One step under a drive voltage, bounded to the rig's limit; NaN counts as zero."""
        limit = self.rig.input_limit
        self._past.appendleft(min(max(drive, -limit), limit) if drive == drive else 0.0)
        late, later = self._past[self._whole], self._past[self._whole + 1]
        self._drive[0] = (1.0 - self._part) * late + self._part * later + self.bias
        self._filter.advance(self._position)
        advance(self._step, self.state, self._drive, self._parameters, self._weights, self.rig.step, self._following)
        self.state[:] = self._following
        self._ticks += 1
        self._read()

    def _read(self) -> None:
        if not self.noisy:
            self._position = float(self.state[0])
            return
        sensor = self.rig.sensor
        hum = np.sqrt(2) * sensor.mains_volts * np.sin(2 * np.pi * sensor.mains_hertz * self.time + self._phase)
        volts = self.state[0] / sensor.radians_per_volt + hum + sensor.white_volts * self._random.standard_normal()
        self._position = sensor.quantised(float(volts)) * sensor.radians_per_volt

    def measure(self) -> Measurement:
        """The sensor's reading now."""
        return Measurement(time=self.time, position=self._position, filtered=self._filter.value)
