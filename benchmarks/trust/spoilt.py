"""Spoilt records: thirty kinds of faults in three strengths each, and the words that name them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

Spoil = Callable[[Record, Rig, int, Generator], Record]
"""A record with a fault of strength 0, 1 or 2."""


@dataclass(frozen=True)
class SpoiltKind:
    """A fault, and the kinds of findings that name it."""

    spoil: Spoil
    named: tuple[str, ...]


def _output(record: Record, change: Callable[[Array], Array]) -> Record:
    return replace(record, output=np.column_stack([change(column) for column in record.output.T]))


def _input(record: Record, change: Callable[[Array], Array]) -> Record:
    return replace(record, input=np.column_stack([change(column) for column in record.input.T]))


def _last(record: Record, change: Callable[[Array], Array]) -> Record:
    """The last output alone, as a single sensor fails."""
    output = record.output.copy()
    output[:, -1] = change(output[:, -1])
    return replace(record, output=output)


def _late(values: Array, record: Record, seconds: float) -> Array:
    return np.interp(record.time - seconds, record.time, values)


def _sampled(values: Array, every: int) -> Array:
    return np.repeat(values[::every], every)[: len(values)]


def _frozen(values: Array, starts: list[int], length: int) -> Array:
    changed = values.copy()
    for start in starts:
        changed[start : start + length] = changed[start]
    return changed


def _spikes(values: Array, count: int, random: Generator, *, zero: bool) -> Array:
    changed, at = values.copy(), random.choice(len(values) - 20, count, replace=False) + 10
    far = 1.5 * np.ptp(values) * random.choice([-1.0, 1.0], count)
    changed[at] = values.min() - 0.6 * np.ptp(values) if zero else np.mean(values) + far
    return changed


def _clipped(values: Array, share: float) -> Array:
    middle = float(np.mean(values))
    return np.clip(values, middle + share * (values.min() - middle), middle + share * (values.max() - middle))


def _coarse(values: Array, share: float, rig: Rig) -> Array:
    """In steps of a share of the range, and of several counts of the rig's own converter."""
    sensor = rig.sensors[-1]
    count = abs(sensor.scale) * sensor.quantiser.count if sensor.quantiser else 0.0
    step = max(share * float(np.ptp(values)), 100.0 * share * count)
    return np.asarray(np.round(values / step) * step)


def _noisy(values: Array, times: float, rig: Rig, random: Generator) -> Array:
    return values + random.normal(size=len(values)) * max(times * _noise_of(rig), 0.01 * float(np.std(values)))


def _hummed(record: Record, share: float, rig: Rig) -> Record:
    """A hum of 50 Hz, or where that is half of the sampling rate, of 60 Hz, which is seen at its mirror image."""
    hertz = 60.0 if record.sampling_time > 0.009 else 50.0
    sine = np.sin(2.0 * np.pi * hertz * record.time)
    return _last(record, lambda y: y + max(share * float(np.std(y)), 5.0 * _noise_of(rig)) * sine)


def _decimated(record: Record, every: int) -> Record:
    count = len(record.time) // every * every
    mean = record.input[:count].reshape(-1, every, record.input.shape[1]).mean(axis=1)
    time = record.sampling_time * every * np.arange(count // every, dtype=np.float64)
    return replace(record, time=time, input=mean, output=record.output[:count:every], measured=None, channels={})


def _aliased(record: Record, amount: float) -> Record:
    """A hum of 60 Hz that was there before a slower converter."""
    every = max(1, round(0.02 / record.sampling_time))
    hummed = _last(record, lambda y: y + amount * np.std(y) * np.sin(2 * np.pi * 60.0 * record.time + 1.0))
    return _decimated(hummed, every)


def _swapped(record: Record, rig: Rig) -> Record:
    if record.output.shape[1] > 1:
        return replace(record, output=record.output[:, ::-1])
    low, high = rig.limits
    scale = 0.9 * min(abs(low[0]), abs(high[0])) / np.abs(record.output).max()
    return replace(record, input=scale * record.output, output=record.input / scale)


def _missing(record: Record, share: float, random: Generator) -> Record:
    measured = random.uniform(size=record.samples) >= share
    output = record.output.copy()
    for column in output.T:
        column[~measured] = np.interp(np.flatnonzero(~measured), np.flatnonzero(measured), column[measured])
    return replace(record, output=output, measured=measured)


def _constant(values: Array) -> Array:
    return np.full_like(values, values[0])


def _short(record: Record, samples: int) -> Record:
    return record.between(100, 100 + samples)


def _noise_of(rig: Rig) -> float:
    sensor = rig.sensors[-1]
    count = sensor.quantiser.count if sensor.quantiser else 0.0
    return abs(sensor.scale) * float(np.hypot(sensor.white_noise, count / np.sqrt(12.0)))


def _stretches(record: Record, seconds: float, count: int) -> tuple[list[int], int]:
    length = round(seconds / record.sampling_time)
    return [round((k + 0.5) * record.samples / count) - length // 2 for k in range(count)], length


DRIFTS, DELAYS, HOLDS, CLIPS = (0.003, 0.006, 0.015), (0.03, 0.06, 0.12), (0.05, 0.1, 0.15), (0.7, 0.5, 0.3)
COUNTS, SMALL = (3, 10, 40), (0.01, 0.003, 0.001)


def _clocked(record: Record, drift: float) -> Record:
    """The clock of the output counts 1 + drift seconds in a second."""
    return _last(record, lambda y: np.interp(record.time / (1.0 + drift), record.time, y))


def _held(values: Array, seconds: float, record: Record) -> Array:
    return _sampled(values, round(seconds / record.sampling_time))


def _tiny(record: Record, share: float) -> Record:
    return _input(_output(record, lambda y: share * y), lambda u: share * u)


def _drifting(record: Record, share: float) -> Record:
    return _last(record, lambda y: y + share * np.ptp(y) * record.time / record.duration)


def _other(record: Record, strength: int) -> Record:
    """The output of another experiment: run backwards, and begun elsewhere."""
    return replace(record, output=np.roll(record.output[::-1], record.samples // (3 + strength), axis=0))


def _unrelated(record: Record, random: Generator) -> Record:
    return _output(record, lambda y: np.std(y) * random.normal(size=len(y)))


# r: record, g: rig, s: strength, n: random numbers
KINDS: Mapping[str, SpoiltKind] = {
    "sensor's sign": SpoiltKind(lambda r, g, s, n: _last(r, np.negative), ("sign",)),
    "input's sign": SpoiltKind(lambda r, g, s, n: _input(r, np.negative), ("sign",)),
    "sensor too large": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: (1.7, 2.0, 5.0)[s] * y), ("scale",)),
    "sensor too small": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: (0.6, 0.5, 0.2)[s] * y), ("scale",)),
    "input too small": SpoiltKind(lambda r, g, s, n: _input(r, lambda u: (0.6, 0.5, 0.1)[s] * u), ("scale",)),
    "late output": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _late(y, r, DELAYS[s])), ("delay",)),
    "late input": SpoiltKind(lambda r, g, s, n: _input(r, lambda u: _late(u, r, DELAYS[s])), ("delay",)),
    "fast clock": SpoiltKind(lambda r, g, s, n: _clocked(r, DRIFTS[s]), ("clock drift",)),
    "slow clock": SpoiltKind(lambda r, g, s, n: _clocked(r, -DRIFTS[s]), ("clock drift",)),
    "clipped output": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _clipped(y, CLIPS[s])), ("clipped",)),
    "clipped input": SpoiltKind(lambda r, g, s, n: _input(r, lambda u: _clipped(u, CLIPS[s])), ("clipped",)),
    "frozen for long": SpoiltKind(
        lambda r, g, s, n: _last(r, lambda y: _frozen(y, *_stretches(r, (1.0, 3.0, 6.0)[s], 1))), ("frozen",)
    ),
    "frozen often": SpoiltKind(
        lambda r, g, s, n: _last(r, lambda y: _frozen(y, *_stretches(r, 0.4, (5, 10, 20)[s]))), ("frozen",)
    ),
    "held output": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _held(y, HOLDS[s], r)), ("held",)),
    "held input": SpoiltKind(lambda r, g, s, n: _input(r, lambda u: _held(u, HOLDS[s], r)), ("held",)),
    "swapped": SpoiltKind(lambda r, g, s, n: _swapped(r, g), ("swapped channels",)),
    "missing": SpoiltKind(lambda r, g, s, n: _missing(r, (0.01, 0.03, 0.08)[s], n), ("missing samples",)),
    "noise": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _noisy(y, (5.0, 10.0, 30.0)[s], g, n)), ("noise",)),
    "spikes": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _spikes(y, COUNTS[s], n, zero=False)), ("spikes",)),
    "dropouts": SpoiltKind(lambda r, g, s, n: _last(r, lambda y: _spikes(y, COUNTS[s], n, zero=True)), ("spikes",)),
    "hum": SpoiltKind(lambda r, g, s, n: _hummed(r, (0.05, 0.1, 0.3)[s], g), ("hum", "aliasing")),
    "aliasing": SpoiltKind(lambda r, g, s, n: _aliased(r, (0.1, 0.2, 0.5)[s]), ("aliasing",)),
    "coarse converter": SpoiltKind(
        lambda r, g, s, n: _last(r, lambda y: _coarse(y, (0.03, 0.06, 0.12)[s], g)), ("quantisation",)
    ),
    "constant output": SpoiltKind(lambda r, g, s, n: _last(r, _constant), ("constant output",)),
    "constant input": SpoiltKind(lambda r, g, s, n: _input(r, _constant), ("no excitation",)),
    "no excitation": SpoiltKind(lambda r, g, s, n: _tiny(r, SMALL[s]), ("no excitation",)),
    "noise alone": SpoiltKind(lambda r, g, s, n: _unrelated(r, n), ("no relation", "noise")),
    "another experiment": SpoiltKind(lambda r, g, s, n: _other(r, s), ("no relation",)),
    "short": SpoiltKind(lambda r, g, s, n: _short(r, (150, 100, 60)[s]), ("short",)),
    "ramp of the sensor": SpoiltKind(lambda r, g, s, n: _drifting(r, (1.0, 2.0, 4.0)[s]), ("sensor drift",)),
}
