"""Reference signals: what drives a rig through an experiment, as functions of time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Reference = Callable[[ArrayLike], NDArray[np.float64]]
"""q(t): seconds in, volts of the sensor out, any shape."""


def hardware_reference(t: ArrayLike) -> NDArray[np.float64]:
    """The 51 s reference of the author's hardware run [V]: a new level every second, then a sine of 0.5 Hz.

    t < 29: 4 (2 frac(43758.5453 sin(12.9898 floor t)) - 1); 30 <= t < 50: 4 sin(2 pi 0.5 (t - 30)); else 0.
    """
    t = np.asarray(t, dtype=float)
    hashed = 43758.5453 * np.sin(12.9898 * np.floor(t))
    steps = 4.0 * (2.0 * (hashed - np.floor(hashed)) - 1.0)
    sine = 4.0 * np.sin(2.0 * np.pi * 0.5 * (t - 30.0))
    return np.where((t >= 0) & (t < 29.0), steps, np.where((t >= 30.0) & (t < 50.0), sine, 0.0))


HARDWARE_DURATION = 51.0
HARDWARE_STEPS = (0.0, 29.0)
HARDWARE_SINE = (30.0, 50.0)


def multisine(seed: int, *, amplitude: float, low: float, high: float, lines: int, period: float) -> Reference:
    """Sum of ``lines`` sines between low and high [Hz], of one period [s], scaled to a peak of ``amplitude`` [V]."""
    random = np.random.default_rng(seed)
    bins = np.unique(np.round(np.linspace(low, high, lines) * period)) / period
    phases = random.uniform(0, 2 * np.pi, len(bins))
    grid = np.linspace(0, period, 20_001)
    peak = np.max(np.abs(np.sum(np.sin(2 * np.pi * bins * grid[:, None] + phases), axis=1)))

    def reference(t: ArrayLike) -> NDArray[np.float64]:
        angle = 2 * np.pi * bins * np.asarray(t, dtype=float)[..., None] + phases
        return amplitude / peak * np.sum(np.sin(angle), axis=-1)

    return reference


def random_steps(seed: int, *, amplitude: float, hold: float, duration: float) -> Reference:
    """Levels within +-amplitude [V], a new one every ``hold`` [s]."""
    levels = np.random.default_rng(seed).uniform(-amplitude, amplitude, int(np.ceil(duration / hold)) + 1)

    def reference(t: ArrayLike) -> NDArray[np.float64]:
        index = np.floor(np.asarray(t, dtype=float) / hold).astype(int)
        return levels[np.clip(index, 0, len(levels) - 1)]

    return reference


def swept_sine(*, amplitude: float, low: float, high: float, duration: float) -> Reference:
    """A sine whose frequency rises evenly from low to high [Hz] over ``duration`` [s]."""

    def reference(t: ArrayLike) -> NDArray[np.float64]:
        t = np.asarray(t, dtype=float)
        return amplitude * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * duration)))

    return reference
