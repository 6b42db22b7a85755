"""The simulated rig: its system at a fine step, with actuator limits and sensor faults."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.core import compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPassFilter, Sensor
from hybrid_sysid_ros.support.arrays import Array

DRAWN = 1024
"""Rows of noise and of disturbances that are computed at once."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Readings of the sensors, in SI."""

    time: float
    """Time [s]."""
    outputs: Array
    """Readings, (outputs,)."""
    filtered: Array
    """Low-pass filtered readings, (outputs,), or plain ones where there is no low-pass."""


class Plant:
    """The rig's system integrated at ``rig.step``, driven by inputs that are bounded and never NaN."""

    def __init__(
        self, rig: Rig, *, seed: int, bias: ArrayLike = 0.0, noisy: bool = True, disturbed: bool = True
    ) -> None:
        """bias: constant added to each input (inputs,), or one for all, which no model knows. noisy: hum, noise and
        quantisation. disturbed: disturbances of states (``rig.disturbances``).
        """
        self.rig = rig
        self.step = rig.step
        self.bias = np.broadcast_to(np.asarray(bias, dtype=float), len(rig.actuators)).copy()
        self.brake = np.zeros(len(rig.system.states))
        """Deceleration of each state by a brake, (states,) [its unit/s], which stops it at zero."""
        self.noisy = noisy
        system, random = rig.system, np.random.default_rng(seed)
        functions = compiled(system)
        self._functions = functions.step, functions.output
        self._parameters, self._weights = system.values, system.weights
        self._phases = random.uniform(0, 2 * np.pi, len(rig.sensors)).tolist()
        self._random = random
        self._noise: Iterator[list[float]] = iter(())
        acting = rig.disturbances if disturbed else {}
        self._disturbances = {index: item.signal(seed=seed) for index, item in acting.items()}
        self._delays = [_split(delay / rig.step) for delay in system.input_delays]
        for item, sensor in zip(rig.system.outputs, rig.sensors, strict=True):
            if sensor.window:
                rig.steps(sensor.window, f"{rig.file}: sensors.{item.name}.window")
        self._channels = [_SensorChannel(sensor, rig.step) for sensor in rig.sensors]
        self._drive, self._outputs = np.zeros(len(rig.actuators)), np.zeros(len(rig.sensors))
        velocities = (system.kinematics.get(index, -1) for index in range(len(system.states)))
        self._velocities = np.array(list(velocities), dtype=np.int64)
        self.stopped = 0
        """Number of steps in which a state was at the end of its travel."""
        self.reset(np.zeros(len(system.states)))

    def reset(self, state: ArrayLike, *, inputs: ArrayLike | None = None) -> None:
        """Start again at time 0 from a state (states,), after constant ``inputs`` (inputs,), or inputs at rest."""
        self._ticks = 0
        self._levels: Iterator[list[float]] = iter(())
        self.state = np.array(state, dtype=float)
        rest = [actuator.rest for actuator in self.rig.actuators]
        stood = np.broadcast_to(rest if inputs is None else np.asarray(inputs, dtype=float), len(rest)).tolist()
        self._past = [
            deque([value] * (whole + 2), maxlen=whole + 2)
            for value, (whole, _) in zip(stood, self._delays, strict=True)
        ]
        self._apply_input_delays()
        for channel, value in zip(self._channels, self._move(steps=0), strict=True):
            channel.reset(value)
        self._read()

    def change(self, **parameters: float) -> None:
        """Change parameters of the system from now on, such as friction when it warms up; delays do not change."""
        names = [item.name for item in self.rig.system.parameters]
        for name, value in parameters.items():
            self._parameters[names.index(name)] = value

    @property
    def applied(self) -> list[float]:
        """Inputs that the actuators apply for the last commands (inputs,), before delays and bias."""
        return [past[0] for past in self._past]

    @property
    def time(self) -> float:
        return self._ticks * self.rig.step

    def advance(self, inputs: ArrayLike) -> None:
        """One step under commanded inputs (inputs,), bounded by the actuators; NaN counts as rest."""
        values = [inputs] if isinstance(inputs, float) else np.atleast_1d(np.asarray(inputs, dtype=float)).tolist()
        for actuator, past, value in zip(self.rig.actuators, self._past, values, strict=True):
            past.appendleft(actuator.reached(value, past[0], self.step))
        self._apply_input_delays()
        self._disturb()
        for channel in self._channels:
            channel.advance()
        outputs = self._braked() if any(self.brake.tolist()) else self._move(steps=1)
        for channel, value in zip(self._channels, outputs, strict=True):
            channel.see(value)
        self._ticks += 1
        self._read()

    def _move(self, *, steps: int) -> list[float]:
        """Advance the state in place under the acting inputs; return the outputs there (outputs,)."""
        self.stopped += _moved(
            *self._functions, self.state, self._drive, self._parameters, self._weights, self.rig.step, steps,
            self._outputs, self.rig.travel, self._velocities,
        )  # fmt: skip
        found: list[float] = self._outputs.tolist()
        return found

    def _braked(self) -> list[float]:
        """One step with the brake, which never reverses a velocity; a state that is held at rest does not move."""
        before = self.state.copy()
        self._move(steps=1)
        most = self.brake * self.step
        self.state -= np.clip(self.state, -most, most)
        for position, velocity in enumerate(self._velocities):
            if velocity >= 0 and most[velocity] and not (before[velocity] or self.state[velocity]):
                self.state[position] = before[position]
        return self._move(steps=0)

    def _apply_input_delays(self) -> None:
        """Set the inputs that act on the system now, after their delays."""
        for index, (past, (whole, part)) in enumerate(zip(self._past, self._delays, strict=True)):
            self._drive[index] = (1.0 - part) * past[whole] + part * past[whole + 1] + self.bias[index]

    def _disturb(self) -> None:
        """Apply the disturbances of states."""
        if not self._disturbances:
            return
        levels = next(self._levels, None)
        if levels is None:
            times = (self._ticks + np.arange(DRAWN)) * self.rig.step
            self._levels = iter(np.column_stack([signal(times) for signal in self._disturbances.values()]).tolist())
            levels = next(self._levels)
        for index, level in zip(self._disturbances, levels, strict=True):
            self.state[index] = level

    def _read(self) -> None:
        if not self.noisy:
            for channel in self._channels:
                channel.read_plainly()
            return
        noise = next(self._noise, None)
        if noise is None:
            self._noise = iter(self._random.standard_normal((DRAWN, len(self._channels))).tolist())
            noise = next(self._noise)
        for channel, phase, white in zip(self._channels, self._phases, noise, strict=True):
            channel.read(self.time, phase, white)

    def outputs(self) -> Array:
        """Outputs without delay and faults of the sensors, (outputs,)."""
        return self._outputs.copy()

    def sensed(self) -> Array:
        """Readings of the sensors, (outputs,)."""
        return self.measure().outputs

    def measure(self) -> Measurement:
        """The sensors' readings now."""
        return Measurement(
            time=self.time,
            outputs=np.array([channel.value for channel in self._channels]),
            filtered=np.array([channel.filtered for channel in self._channels]),
        )


@kernel
def _moved(
    step: int,
    output: int,
    x: Array,
    u: Array,
    p: Array,
    w: Array,
    h: float,
    steps: int,
    y: Array,
    travel: Array,
    velocities: NDArray[np.int64],
) -> int:
    """Advance x (states,) in place under u (inputs,), and compute outputs y (outputs,), by addresses of compiled code.

    travel (2, states): a state that would leave it stays at its end, and its velocity, whose index is in ``velocities``
    (states,), -1 for none, is limited to zero in that direction. Returns the number of steps in which this happened.
    """
    following, stopped = np.empty(x.shape[0]), 0
    for _ in range(steps):
        call_value(step, x, u, p, w, h, 0.0, following)
        ended = False
        for i in range(x.shape[0]):
            x[i] = min(max(following[i], travel[0, i]), travel[1, i])
            ended = ended or x[i] != following[i]
        for i in range(x.shape[0]):
            v = velocities[i]
            if v >= 0 and x[i] != following[i]:
                x[v] = min(x[v], 0.0) if x[i] < following[i] else max(x[v], 0.0)
        stopped += ended
    call_value(output, x, u, p, w, h, 0.0, y)
    return stopped


class _SensorChannel:
    """One running sensor: its delayed outputs, its reading [SI] and its low-pass."""

    def __init__(self, sensor: Sensor, step: float) -> None:
        self._sensor = sensor
        self._low_pass = LowPassFilter(sensor.low_pass, step) if sensor.low_pass else None
        self._whole, self._part = _split(sensor.delay / step)
        self._window = round(sensor.window / step)
        self.value = 0.0

    @property
    def filtered(self) -> float:
        return self.value if self._low_pass is None else self._low_pass.value

    def reset(self, output: float) -> None:
        """Set the steady state at an output."""
        self._past = deque([output] * (self._whole + 2), maxlen=self._whole + 2)
        if self._low_pass is not None:
            self._low_pass.reset(output)
        self._sum = 0.0
        before = [k * output / self._sensor.scale / max(self._window, 1) for k in range(-self._window, 1)]
        self._counts = deque(map(self._counted, before), maxlen=self._window + 1)

    def see(self, output: float) -> None:
        self._past.appendleft(output)

    def advance(self) -> None:
        """Advance the low-pass by one step with the current reading."""
        if self._low_pass is not None:
            self._low_pass.advance(self.value)

    def read_plainly(self) -> None:
        """Update the reading without faults except the delay."""
        if self._part == 0.0:
            self.value = self._past[self._whole]
        else:
            self.value = (1.0 - self._part) * self._past[self._whole] + self._part * self._past[self._whole + 1]

    def read(self, time: float, phase: float, white: float) -> None:
        """Update the reading with a hum of a phase, and a standard normal number as white noise."""
        self.read_plainly()
        sensor, hum = self._sensor, 0.0
        if sensor.hum is not None:
            hum = math.sqrt(2) * sensor.hum.rms * math.sin(2 * math.pi * sensor.hum.hertz * time + phase)
        reading = self.value / sensor.scale + hum
        if self._window:  # the noise is half that of each end
            self._sum += reading / self._window
            self._counts.append(self._counted(self._sum + math.sqrt(0.5) * sensor.white_noise * white))
            self.value = (self._counts[-1] - self._counts[0]) * sensor.scale
        else:
            self.value = self._counted(reading + sensor.white_noise * white) * sensor.scale

    def _counted(self, reading: float) -> float:
        return self._sensor.quantiser.read(reading) if self._sensor.quantiser else reading


def _split(steps: float) -> tuple[int, float]:
    """A delay as whole steps and the remaining part of a step."""
    whole = int(steps)
    return whole, steps - whole
