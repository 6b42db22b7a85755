"""Kinds of references that closed loops follow, each as fast as the length of the horizon lets it be followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import LENGTH, Spread, magnitude
from hybrid_sysid_ros.rigs.excitation import Reference, multisine, random_steps, sine, swept_sine
from hybrid_sysid_ros.support.arrays import Array

SMALLEST = 0.2
"""Size of a reference, in the amplitude."""
HOLD = 0.75, 5.0
"""Shortest and longest time between two jumps, in horizons."""
SLOWEST, FASTEST = 0.04, 0.8
"""Frequencies of a wave, in periods a horizon."""


def references(
    random: np.random.Generator, spread: Spread, problem: ControlProblem, kind: str = ""
) -> Callable[[ArrayLike], Array]:
    """References (times, p) of a kind over the times [s], each output by itself; of any kind where none is named."""
    horizon = problem.horizon * problem.period
    found = [
        _drawn(random, amplitude, horizon, kind) if weight > 0 and amplitude > 0 else _zero
        for amplitude, weight in zip(spread.amplitude, problem.output_weights, strict=True)
    ]
    return lambda times: np.column_stack(
        [centre + one(times) for centre, one in zip(spread.centre, found, strict=True)]
    )


def _zero(times: ArrayLike) -> Array:
    return np.zeros_like(np.asarray(times, dtype=float))


def _drawn(random: np.random.Generator, amplitude: float, horizon: float, kind: str) -> Reference:
    """One within +-amplitude."""
    drawn = KINDS[kind or [*KINDS][int(random.integers(len(KINDS)))]]
    return drawn(random, amplitude, amplitude * magnitude(random, SMALLEST), horizon)


def _steps(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    hold, seed = random.uniform(*HOLD) * horizon, int(random.integers(2**31))
    return random_steps(seed, amplitude=size, hold=hold, duration=(LENGTH + HOLD[1]) * horizon)


def _square_wave(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    phase, hold = random.uniform(0.0, 2.0), random.uniform(*HOLD) * horizon
    return lambda t: np.where(np.mod(np.asarray(t, dtype=float) / hold + phase, 2.0) < 1.0, size, -size)


def _sine(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    """One sine, a sum of sines, or a swept one."""
    which, seed = random.integers(3), int(random.integers(2**31))
    fastest, phase = random.uniform(3.0 * SLOWEST, FASTEST), random.uniform(0.0, 25.0) * horizon
    if which == 0:
        one = sine(amplitude=size, frequency=fastest / horizon)
    elif which == 1:
        high, period = 1.5 * fastest / horizon, 25.0 * horizon
        one = multisine(seed, amplitude=size, low=SLOWEST / horizon, high=high, lines=12, period=period)
    else:
        return swept_sine(amplitude=size, low=SLOWEST / horizon, high=fastest / horizon, duration=LENGTH * horizon)
    return lambda t: one(np.asarray(t, dtype=float) + phase)


def _triangle(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    phase, rate = random.uniform(0.0, 1.0), random.uniform(SLOWEST, FASTEST) / horizon

    def triangle(t: ArrayLike) -> Array:
        part = np.mod(np.asarray(t, dtype=float) * rate + phase, 1.0)
        return np.asarray(size * (4.0 * np.abs(part - 0.5) - 1.0))

    return triangle


def _ramp(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    """A ramp up to the amplitude, where it stays."""
    offset, slope = random.uniform(-amplitude, amplitude), random.normal() * 0.2 * size / horizon

    def ramp(t: ArrayLike) -> Array:
        along = offset + slope * (np.asarray(t, dtype=float) - 0.5 * LENGTH * horizon)
        return np.clip(along, -amplitude, amplitude)

    return ramp


def _rest(random: np.random.Generator, amplitude: float, size: float, horizon: float) -> Reference:
    """One level."""
    level = size * random.uniform(-1.0, 1.0)
    return lambda t: np.full_like(np.asarray(t, dtype=float), level)


KINDS: Mapping[str, Callable[[np.random.Generator, float, float, float], Reference]] = {
    "steps": _steps,
    "square waves": _square_wave,
    "sines": _sine,
    "triangles": _triangle,
    "ramps": _ramp,
    "rests": _rest,
}
"""Of random numbers, amplitude, size, and length of the horizon [s]."""
