"""An angle sensor: its scale, quantisation, noise and filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, tf2ss

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """radians_per_volt: the scale between the sensor's volts and SI. range_volts, bits: of the converter, +-range.

    mains_volts (rms) at mains_hertz: hum with one random phase per run; white_volts (rms): the rest of the noise.
    filter_hertz, filter_order: Butterworth low-pass of the measured signal, run by forward Euler.
    """

    radians_per_volt: float
    range_volts: float
    bits: int
    mains_volts: float
    mains_hertz: float
    white_volts: float
    filter_hertz: float
    filter_order: int

    @property
    def noise_volts(self) -> float:
        """Noise in all, rms [V]."""
        return float(np.hypot(self.mains_volts, self.white_volts))

    def volts(self, radians: Array) -> Array:
        return np.asarray(radians) / self.radians_per_volt

    def radians(self, volts: Array) -> Array:
        return np.asarray(volts) * self.radians_per_volt

    def quantised(self, volts: float) -> float:
        """The converter's reading of a voltage."""
        count = 2 * self.range_volts / 2**self.bits
        return min(max(round(volts / count) * count, -self.range_volts), self.range_volts)


class Filter:
    """The sensor's low-pass at a fixed step, forward Euler as on the rig: x+ = x + h (A x + b y), yf = c x."""

    def __init__(self, sensor: Sensor, step: float) -> None:
        numerator, denominator = butter(sensor.filter_order, 2 * np.pi * sensor.filter_hertz, analog=True)
        a, b, c, _ = tf2ss(numerator, denominator)
        # Balanced by powers of the cut-off frequency: the companion form alone spans 12 decades.
        balance = (2 * np.pi * sensor.filter_hertz) ** np.arange(len(a))
        a = a * balance[None, :] / balance[:, None]
        self._transition = np.eye(len(a)) + step * a
        self._input = step * (b[:, 0] / balance)
        self._output = c[0] * balance
        self._state = np.zeros(len(a))

    @property
    def value(self) -> float:
        return float(self._output @ self._state)

    def reset(self, value: float) -> None:
        """Settle at a constant input."""
        self._state = np.linalg.solve(np.eye(len(self._state)) - self._transition, self._input * value)

    def advance(self, value: float) -> None:
        self._state = self._transition @ self._state + self._input * value
