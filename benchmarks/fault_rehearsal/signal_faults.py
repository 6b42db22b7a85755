"""Faults of sensors and actuators, as what they make of readings or inputs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.faults.distrust import SHARE, STUCK
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

LASTING = 2.0
"""Time of a fault [s]."""


@dataclass
class Moment:
    """What a fault may alter of a sample, and what it may know of it."""

    since: float
    """Time since the fault began [s]."""
    number: int
    """Samples since then."""
    random: np.random.Generator


Acting = Callable[[Moment, Array], Array]
"""Makes of readings (p,) or inputs (m,) other ones; it may remember, for it is made anew for each fault."""


@dataclass(frozen=True)
class Fault:
    """reads: of the readings; acts: of the inputs; told: whether the measured inputs are those that act."""

    reads: Callable[[], Acting] | None = None
    acts: Callable[[], Acting] | None = None
    told: bool = True


def _plain(change: Acting) -> Callable[[], Acting]:
    return lambda: change


def _one(k: int, change: Callable[[Moment, float], float]) -> Callable[[], Acting]:
    """Of one entry alone."""

    def acting(moment: Moment, values: Array) -> Array:
        values[k] = change(moment, float(values[k]))
        return values

    return lambda: acting


def _held(k: int, noise: float, count: float = 0.0) -> Callable[[], Acting]:
    """The first value, with noise, and dithered by a count."""

    def make() -> Acting:
        first: list[float] = []

        def acting(moment: Moment, values: Array) -> Array:
            first.append(float(values[k]))
            values[k] = first[0] + noise * moment.random.standard_normal() + count * (moment.number % 2)
            return values

        return acting

    return make


def _late(samples: int, jitter: int = 0) -> Callable[[], Acting]:
    """Values of some samples ago under the stamp of now."""

    def make() -> Acting:
        past: deque[Array] = deque(maxlen=samples + jitter + 1)

        def acting(moment: Moment, values: Array) -> Array:
            past.append(values.copy())
            back = samples + int(moment.random.integers(0, jitter + 1))
            return past[max(len(past) - 1 - back, 0)].copy()

        return acting

    return make


def _lagging(share: float) -> Callable[[], Acting]:
    """Follow by a share of the distance in each sample."""

    def make() -> Acting:
        followed: list[Array] = []

        def acting(moment: Moment, values: Array) -> Array:
            followed[:] = [followed[0] + share * (values - followed[0])] if followed else [values.copy()]
            return followed[0].copy()

        return acting

    return make


def _on(moment: Moment, period: float) -> bool:
    """Every other of half periods [s]."""
    return (moment.since % period) < 0.5 * period


def _of_sensor(k: int, size: float, noise: float, count: float) -> dict[str, Callable[[], Acting]]:
    """By kind, of reading k. size: of a fault. noise: rms. count: of its quantiser. All in SI."""
    return {
        "sign flips": _one(k, lambda m, y: -y),
        "gain .5": _one(k, lambda m, y: 0.5 * y),
        "dithers by a count": _held(k, 0.0, count),
        "stands still": _held(k, 0.0),
        "60 % spikes": _one(k, lambda m, y: y + size * float(m.random.random() < SHARE)),
        "drifts": _one(k, lambda m, y: y + size * m.since / LASTING),
        "no number": _one(k, lambda m, y: math.nan),
        # kinds of their own
        "stands still with noise": _held(k, noise),
        "shows noise alone": _one(k, lambda m, y: noise * m.random.standard_normal()),
        "gain drifts to 2": _one(k, lambda m, y: y * (1.0 + m.since / LASTING)),
        "gain -.3": _one(k, lambda m, y: -0.3 * y),
        "drifts slowly": _one(k, lambda m, y: y + 0.25 * size * m.since / LASTING),
        "jumps": _one(k, lambda m, y: y + 0.5 * size),
        "jumps to and fro": _one(k, lambda m, y: y + size * _on(m, 0.2)),
        "comes and goes": _one(k, lambda m, y: math.nan if _on(m, 0.3) else y),
        "flips to and fro": _one(k, lambda m, y: -y if _on(m, 0.3) else y),
        "is ten times as noisy": _one(k, lambda m, y: y + 10 * noise * m.random.standard_normal()),
        "is at its end": _one(k, lambda m, y: 2.5 * size),
    }


def sensor_faults(rig: Rig, sizes: Array) -> dict[str, Fault]:
    """By name."""
    found: dict[str, Fault] = {}
    for k, (item, sensor) in enumerate(zip(rig.system.outputs, rig.sensors, strict=True)):
        noise = abs(sensor.scale) * max(sensor.noise, 0.0)
        count = abs(sensor.scale) * (sensor.quantiser.count if sensor.quantiser else 0.1 * sensor.white_noise)
        kinds = _of_sensor(k, float(sizes[k]), noise, count)
        found |= {f"{item.name} {name}": Fault(reads=make) for name, make in kinds.items()}
    found |= {
        "all sensors flip": Fault(reads=_plain(lambda m, y: -y)),
        "all sensors jump": Fault(reads=_plain(lambda m, y: y + 0.5 * sizes)),
        "all sensors drift": Fault(reads=_plain(lambda m, y: y + sizes * m.since / LASTING)),
        "readings 10 samples old": Fault(reads=_late(10)),
        "readings 0 to 8 samples old": Fault(reads=_late(0, 8)),
        "readings 4 to 8 samples old": Fault(reads=_late(4, 4)),
    }
    return found


def _of_actuator(k: int, stuck: float, span: float) -> dict[str, Callable[[], Acting]]:
    """By kind, of input k. stuck: where it sticks. span: of its range."""
    return {
        "flips": _one(k, lambda m, u: -u),
        "is stuck": _one(k, lambda m, u: stuck),
        "is disconnected": _one(k, lambda m, u: 0.0),
        # kinds of their own
        "has half its gain": _one(k, lambda m, u: 0.5 * u),
        "has twice its gain": _one(k, lambda m, u: 2.0 * u),
        "stands still": _held(k, 0.0),
        "is stuck low": _one(k, lambda m, u: -stuck),
        "comes and goes": _one(k, lambda m, u: 0.0 if _on(m, 0.3) else u),
        "flips to and fro": _one(k, lambda m, u: -u if _on(m, 0.3) else u),
        "hunts": _one(k, lambda m, u: u + 0.3 * span * (1.0 if _on(m, 0.2) else -1.0)),
        "is off by a tenth": _one(k, lambda m, u: u + 0.1 * span),
        "creeps away": _one(k, lambda m, u: u + 0.5 * span * m.since / LASTING),
        "loses its gain": _one(k, lambda m, u: u * (1.0 - m.since / LASTING)),
    }


def actuator_faults(rig: Rig) -> dict[str, Fault]:
    """By name."""
    found: dict[str, Fault] = {}
    for k, (item, actuator) in enumerate(zip(rig.system.inputs, rig.actuators, strict=True)):
        kinds = _of_actuator(k, STUCK * actuator.high, actuator.high - actuator.low)
        for name, make in kinds.items():
            found |= {
                f"{item.name} {name}{'' if told else ', unreported'}": Fault(acts=make, told=told)
                for told in (True, False)
            }
    for told in (True, False):
        end = "" if told else ", unreported"
        found |= {
            f"inputs lag{end}": Fault(acts=_lagging(0.05), told=told),
            f"inputs 10 samples late{end}": Fault(acts=_late(10), told=told),
        }
    found["sensor and actuator stand still"] = Fault(reads=_held(0, 0.0), acts=_held(0, 0.0), told=False)
    return found
