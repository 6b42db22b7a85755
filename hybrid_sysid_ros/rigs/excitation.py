"""Signals that drive a rig through an experiment, or that its outputs are to follow, as functions of time."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers, refuse_unknown

Reference = Callable[[ArrayLike], Array]
"""q(t): seconds in, any shape; values of the same shape out, in the unit of the amplitude."""


def constant(*, level: float, begin: float = 0.0) -> Reference:
    """One level, from ``begin`` [s] on; 0 before."""
    return lambda t: np.where(np.asarray(t, dtype=float) >= begin, float(level), 0.0)


def ramp(*, first: float, level: float, duration: float) -> Reference:
    """A line from ``first`` to ``level`` over the duration [s]; the level is held from then on."""
    return lambda t: first + (level - first) * np.clip(np.asarray(t, dtype=float) / duration, 0.0, 1.0)


def sine(*, amplitude: float, frequency: float) -> Reference:
    """A sine with a frequency [Hz]."""
    return lambda t: amplitude * np.sin(2.0 * np.pi * frequency * np.asarray(t, dtype=float))


PEAK_SAMPLES = 20_000
"""Samples of a period, at least, among which the peak of a sum of sines is looked for."""


def multisine(seed: int, *, amplitude: float, low: float, high: float, lines: int, period: float) -> Reference:
    """Sum of ``lines`` sines between low and high [Hz] with a common period [s], scaled to the peak ``amplitude``."""
    random = np.random.default_rng(seed)
    cycles = np.unique(np.round(np.linspace(low, high, int(lines)) * period)).astype(int)
    bins, phases = cycles / period, random.uniform(0, 2 * np.pi, len(cycles))
    count = max(PEAK_SAMPLES, 2 * int(cycles[-1]) + 2)
    spectrum = np.zeros(count // 2 + 1, complex)
    spectrum[cycles] = np.exp(1j * (phases - 0.5 * np.pi)) * np.where(cycles > 0, 0.5, 1.0) * count
    peak = np.max(np.abs(np.fft.irfft(spectrum, count)))

    def reference(t: ArrayLike) -> Array:
        angle = 2 * np.pi * bins * np.asarray(t, dtype=float)[..., None] + phases
        return np.asarray(amplitude / peak * np.sum(np.sin(angle), axis=-1))

    return reference


def random_steps(seed: int, *, amplitude: float, hold: float, duration: float) -> Reference:
    """Levels within +-amplitude, a new one every ``hold`` [s]; the last one is held after the duration [s]."""
    levels = np.random.default_rng(seed).uniform(-amplitude, amplitude, int(np.ceil(duration / hold)) + 1)

    def reference(t: ArrayLike) -> Array:
        index = np.floor(np.asarray(t, dtype=float) / hold).astype(int)
        return np.asarray(levels[np.clip(index, 0, len(levels) - 1)])

    return reference


def random_levels(
    seed: int, *, amplitude: float, shortest: float, longest: float, most: float, duration: float, begin: float = 0.0
) -> Reference:
    """Levels within +-amplitude, each held for a random time from shortest to longest [s], none further than ``most``
    from the one before; 0 before ``begin`` [s]. The last one is held after the duration [s].

    Raises UserError where longest is below shortest.
    """
    if shortest > longest:
        raise UserError(f"random_levels: shortest, {shortest:g} s, is above longest, {longest:g} s")
    random = np.random.default_rng(seed)
    times, levels = [begin], [0.0]
    while times[-1] < duration:
        low, high = max(levels[-1] - most, -amplitude), min(levels[-1] + most, amplitude)
        levels.append(random.uniform(low, high))
        times.append(times[-1] + random.uniform(shortest, longest))

    def reference(t: ArrayLike) -> Array:
        index = np.searchsorted(times, np.asarray(t, dtype=float), side="right")
        return np.asarray(np.array(levels)[np.minimum(index, len(levels) - 1)])

    return reference


def pulse_train(*, amplitude: float, every: float, width: float, begin: float = 0.0) -> Reference:
    """Pulses of one height and width [s], one every ``every`` seconds, the first at ``begin`` [s]."""

    def reference(t: ArrayLike) -> Array:
        since = np.asarray(t, dtype=float) - begin
        return np.where((since >= 0.0) & (np.mod(since, every) < width), amplitude, 0.0)

    return reference


def hashed_steps(*, amplitude: float, hold: float = 1.0) -> Reference:
    """Levels within +-amplitude, a new one every ``hold`` [s]: level k is 2 frac(43758.5453 sin(12.9898 k)) - 1.

    This hash from graphics shaders gives the same levels in every language, without a random generator.
    """

    def reference(t: ArrayLike) -> Array:
        hashed = 43758.5453 * np.sin(12.9898 * np.floor(np.asarray(t, dtype=float) / hold))
        return np.asarray(amplitude * (2.0 * (hashed - np.floor(hashed)) - 1.0))

    return reference


def swept_sine(*, amplitude: float, low: float, high: float, duration: float) -> Reference:
    """A sine whose frequency rises evenly from low to high [Hz] over ``duration`` [s]."""

    def reference(t: ArrayLike) -> Array:
        t = np.asarray(t, dtype=float)
        return amplitude * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * duration)))

    return reference


def pulses(
    seed: int, *, amplitude: float, shortest: float, longest: float, apart: float, rise: float = 0.2
) -> Reference:
    """Pulses as from a hand: one at a random time in each ``apart`` [s], with a random length from shortest to longest
    [s], a random height from a third of the amplitude to all of it, and flanks of ``rise`` [s].

    Raises UserError where they don't fit into ``apart``.
    """
    if not shortest <= longest <= apart:
        raise UserError(
            f"pulses of {shortest:g} to {longest:g} s, one in {apart:g} s: shortest, longest, apart must grow"
        )

    def reference(t: ArrayLike) -> Array:
        t = np.asarray(t, dtype=float)
        numbers, places = np.unique(np.maximum(np.floor(t / apart), 0.0).astype(int), return_inverse=True)
        drawn = np.array([np.random.default_rng((seed, k)).uniform(size=3) for k in numbers.tolist()]).reshape(-1, 3)
        lengths = shortest + (longest - shortest) * drawn[:, 0]
        starts = numbers * apart + (apart - lengths) * drawn[:, 1]
        heights = amplitude * (1.0 + 2.0 * drawn[:, 2]) / 3.0
        length, start, height = (values[places].reshape(t.shape) for values in (lengths, starts, heights))
        inside = np.minimum(t - start, start + length - t)  # from the nearer flank
        return np.asarray(height * np.clip(inside / rise, 0.0, 1.0))

    return reference


KINDS: Mapping[str, Callable[..., Reference]] = {
    function.__name__: function
    for function in (
        constant,
        ramp,
        sine,
        multisine,
        random_steps,
        random_levels,
        hashed_steps,
        swept_sine,
        pulses,
        pulse_train,
    )
}
LEAST = {
    **dict.fromkeys(("hold", "period", "shortest", "longest", "apart", "rise", "most", "every", "width"), 1e-9),
    "lines": 1,
}
"""Least values of a kind's numbers."""
ONE_SIDED = ("constant", "ramp", "pulses", "pulse_train")
"""Kinds that go from 0 to one level, or from one level to another."""
GIVEN = ("seed", "duration", "period")
"""Numbers that the caller of a signal gives; the period of a multisine is its duration by default."""


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """A signal by its kind and numbers, as a YAML file declares it."""

    kind: str
    numbers: Mapping[str, float]

    @classmethod
    def of(cls, content: object, where: str) -> Excitation:
        """From ``{kind: multisine, amplitude: 2, ...}``. Raises UserError for other keys than the kind has."""
        values = dict(content) if isinstance(content, Mapping) else {}
        kind = values.pop("kind", None)
        if not isinstance(kind, str) or kind not in KINDS:
            raise UserError(f"{where}: kind is {kind!r}: choose one of {', '.join(KINDS)}")
        parameters = inspect.signature(KINDS[kind]).parameters
        known = tuple(name for name in parameters if name not in GIVEN)
        refuse_unknown(values, (*known, *(("period",) if "period" in parameters else ())), where)
        for name in known:
            if name not in values and parameters[name].default is inspect.Parameter.empty:
                raise UserError(f"{where}: {name} is missing")
        for name, value in values.items():
            (values[name],) = numbers(value, f"{where}.{name}", count=1)
            if values[name] < LEAST.get(name, -math.inf):
                raise UserError(f"{where}.{name} is {values[name]:g}: it must be above 0")
        return cls(kind=kind, numbers=values)

    def beyond(self, low: float, high: float) -> str:
        """Words for the part of the signal beyond limits; where limits are on one side of 0, the other is ignored."""
        most = (min if low < 0.0 < high else max)(-low, high)
        for name in ("first", "level", "amplitude"):
            value = self.numbers.get(name, 0.0)
            if not (low <= value <= high if self.kind in ONE_SIDED else abs(value) <= most) and name in self.numbers:
                return f"{name} {value:g}"
        return ""

    @property
    def largest(self) -> float:
        """The largest magnitude that its numbers name."""
        return max(abs(self.numbers.get(name, 0.0)) for name in ("first", "level", "amplitude"))

    @property
    def endless(self) -> bool:
        """Whether the signal never ends."""
        parameters = inspect.signature(KINDS[self.kind]).parameters
        return "duration" not in parameters and ("period" not in parameters or "period" in self.numbers)

    def signal(self, *, seed: int = 0, duration: float = math.inf) -> Reference:
        """The signal as a function of time. duration [s]: of a sweep or of steps, and a multisine's default period."""
        parameters = inspect.signature(KINDS[self.kind]).parameters
        given = {"seed": seed, "duration": duration, "period": duration}
        values = {name: value for name, value in given.items() if name in parameters} | dict(self.numbers)
        return KINDS[self.kind](**values)


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A piece of a schedule: a signal of one output from ``start`` up to, but without, ``stop`` [s].

    The signal's time begins at ``start``.
    """

    name: str
    output: int
    start: float
    stop: float
    excitation: Excitation


@dataclass(frozen=True, kw_only=True)
class ReferenceSchedule:
    """References of the outputs in display units, by segments, and 0 elsewhere."""

    name: str
    duration: float
    """[s]"""
    outputs: int
    segments: Sequence[Segment]

    @property
    def windows(self) -> dict[str, tuple[float, float]]:
        """Windows in which tracking is judged, by the segments' names: start and stop [s]."""
        return {segment.name: (segment.start, segment.stop) for segment in self.segments}

    def of(self, output: int) -> Reference:
        """The reference of one output."""
        pieces = [
            (piece, piece.excitation.signal(duration=piece.stop - piece.start))
            for piece in self.segments
            if piece.output == output
        ]

        def reference(t: ArrayLike) -> Array:
            t = np.asarray(t, dtype=float)
            values = np.zeros(t.shape)
            for piece, signal in pieces:
                values = np.where((t >= piece.start) & (t < piece.stop), signal(t - piece.start), values)
            return values

        return reference

    def __call__(self, t: ArrayLike) -> Array:
        """References (..., outputs) at times of any shape [s]."""
        return np.stack([reference(t) for reference in self._references], axis=-1)

    @cached_property
    def _references(self) -> list[Reference]:
        return [self.of(output) for output in range(self.outputs)]
