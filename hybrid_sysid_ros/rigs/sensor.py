"""An angle sensor: its scale, quantisation, noise and filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    """The sensor's low-pass at a fixed step, forward Euler as on the rig: x+ = x + h (A x + b y), yf = c x.

    transition (order, order): I + h A, gain (order,): h b, reading (order,): c.
    """

    def __init__(self, sensor: Sensor, step: float) -> None:
        # Butterworth poles on the left half of the unit circle, in time counted by the cut-off frequency: the companion
        # form is then balanced. (scipy.signal has it too, but would cost every node 60 MB.)
        order = sensor.filter_order
        poles = np.exp(1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order))
        cut_off = 2 * np.pi * sensor.filter_hertz
        companion = np.eye(order, k=-1)
        companion[0] = -np.poly(poles).real[1:]
        self.transition = np.eye(order) + step * cut_off * companion
        self.gain = step * cut_off * np.eye(order)[0]
        self.reading = np.eye(order)[-1]
        self.state = np.zeros(order)

    @property
    def value(self) -> float:
        return float(self.reading @ self.state)

    def reset(self, value: float) -> None:
        """Settle at a constant input."""
        self.state = np.linalg.solve(np.eye(len(self.state)) - self.transition, self.gain * value)

    def advance(self, value: float) -> None:
        self.state = self.transition @ self.state + self.gain * value
