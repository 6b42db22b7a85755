"""A sensor, made of parts: scale, delay, window, hum, white noise, quantiser and low-pass."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Display:
    """The unit in which an output is displayed, weighted and configured."""

    unit: str
    scale: float
    """SI per unit."""

    def shown(self, value: ArrayLike) -> Array:
        """A value in the display unit, from SI."""
        return np.asarray(value, dtype=float) / self.scale

    def si(self, value: ArrayLike) -> Array:
        """A value in SI, from the display unit."""
        return np.asarray(value, dtype=float) * self.scale


@dataclass(frozen=True, kw_only=True)
class Hum:
    """A sine of known frequency in the readings, with a random phase for each run."""

    rms: float
    """Root mean square [reading unit]."""
    hertz: float

    def __post_init__(self) -> None:
        _at_least_zero(self, "rms", "hertz")


CONSTANT = 1e-3
"""Periods of a hum, from a whole number, up to which samples show no more of it than an offset."""


@dataclass(frozen=True, kw_only=True)
class Quantiser:
    """An analogue-to-digital converter over +-range, or an encoder without limits."""

    range: float = math.inf
    """Largest reading, +- [reading unit]."""
    bits: int = 0
    """Bits of the converter; 0: ``count`` is its resolution."""
    count: float = 0.0
    """One count [reading unit]."""

    def __post_init__(self) -> None:
        if self.bits > 0 and math.isfinite(self.range) and not self.count:
            object.__setattr__(self, "count", 2 * self.range / 2**self.bits)
        if not (self.count > 0 and math.isfinite(self.count) and self.range > 0):
            raise UserError("a quantiser needs a count above 0, or range and bits")

    def read(self, value: float) -> float:
        """The nearest count within the range; non-finite values stay."""
        if not math.isfinite(value):
            return min(max(value, -self.range), self.range)
        return min(max(round(value / self.count) * self.count, -self.range), self.range)


@dataclass(frozen=True, kw_only=True)
class LowPass:
    """A Butterworth low-pass of the readings, run by forward Euler; experiments may feed its output back."""

    hertz: float
    order: int

    def __post_init__(self) -> None:
        if not (self.hertz > 0 and math.isfinite(self.hertz) and 1 <= self.order <= 12):
            raise UserError(f"low_pass: {self.hertz:g} Hz of order {self.order}: needs more than 0 Hz and 1 to 12")


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """The path from an output to its readings; every part may be missing."""

    unit: str
    """Unit of a reading, in which the output is also displayed."""
    scale: float = 1.0
    """SI per unit of a reading."""
    white_noise: float = 0.0
    """Standard deviation [reading unit]."""
    hum: Hum | None = None
    quantiser: Quantiser | None = None
    low_pass: LowPass | None = None
    delay: float = 0.0
    """Age of a reading [s]."""
    window: float = 0.0
    """Time [s] over which a reading is a mean, with quantised sums, as of a pulse counter; 0: it is instantaneous."""

    def __post_init__(self) -> None:
        if not (self.scale != 0 and math.isfinite(self.scale)):
            raise UserError(f"scale is {self.scale:g}: it needs a number of SI units per {self.unit or 'reading'}")
        _at_least_zero(self, "white_noise", "delay", "window")
        if self.window and self.quantiser and math.isfinite(self.quantiser.range):
            raise UserError("a counter of pulses, one with a window, has no range: give its quantiser a count alone")

    @property
    def display(self) -> Display:
        """The display unit, which is that of the readings."""
        return Display(unit=self.unit, scale=self.scale)

    @property
    def noisy(self) -> bool:
        """Whether noise changes its readings, so that many equal ones are a fault."""
        return self.white_noise > (0.5 * self.quantiser.count if self.quantiser else 0.0)

    @property
    def noise(self) -> float:
        """Total noise, rms [reading unit]."""
        return math.hypot(self.hum.rms if self.hum else 0.0, self.white_noise)

    @property
    def floor(self) -> float:
        """The noise with that of rounding, of both ends of a window, rms [reading unit]."""
        rounded = self.quantiser.count / math.sqrt(6.0 if self.window else 12.0) if self.quantiser else 0.0
        return math.hypot(self.noise, rounded)

    def floor_of(self, period: float) -> float:
        """That of samples of a period [s]: a hum whose periods fit into it is an offset there."""
        periods = self.hum.hertz * period if self.hum else 0.5
        return self.floor if abs(periods - round(periods)) > CONSTANT else replace(self, hum=None).floor


class LowPassFilter:
    """A low-pass at a fixed step, forward Euler: x+ = x + h (A x + b y), yf = c x.

    transition (order, order): I + h A, gain (order,): h b, reading (order,): c.
    """

    def __init__(self, part: LowPass, step: float) -> None:
        # Butterworth poles on the left half of the unit circle, in time counted by the cut-off frequency: the companion
        # form is then balanced. (scipy.signal has it too, but would cost every node 60 MB.)
        order = part.order
        poles = np.exp(1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order))
        cut_off = 2 * np.pi * part.hertz
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
        """Set the steady state of a constant input."""
        self.state = np.linalg.solve(np.eye(len(self.state)) - self.transition, self.gain * value)

    def advance(self, value: float) -> None:
        self.state = self.transition @ self.state + self.gain * value


def _at_least_zero(part: object, *names: str) -> None:
    for name in names:
        value = getattr(part, name)
        if not (value >= 0 and math.isfinite(value)):
            raise UserError(f"{name} is {value:g}: it must not be negative")
