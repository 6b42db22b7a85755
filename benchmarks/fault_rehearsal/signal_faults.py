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
    """reads: of the readings; acts: of the inputs; told: whether the measured inputs are those that act; tells: what is
    measured of these.
    """

    reads: Callable[[], Acting] | None = None
    acts: Callable[[], Acting] | None = None
    told: bool = True
    tells: Callable[[], Acting] | None = None


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


def _growing(steps: int) -> Callable[[], Acting]:
    """Values that are later and later under the stamp of now, by ``steps`` samples in the end."""

    def make() -> Acting:
        past: list[Array] = []

        def acting(moment: Moment, values: Array) -> Array:
            past.append(values.copy())
            back = round(steps * moment.since / LASTING)
            return past[max(len(past) - 1 - back, 0)].copy()

        return acting

    return make


def _every(count: int) -> Callable[[], Acting]:
    """The same values for some samples."""

    def make() -> Acting:
        held: list[Array] = []

        def acting(moment: Moment, values: Array) -> Array:
            if moment.number % count == 0:
                held[:] = [values.copy()]
            return held[0].copy()

        return acting

    return make


def _followed(k: int, step: Callable[[float, float], float]) -> Callable[[], Acting]:
    """What becomes of the value before and the one that is asked."""

    def make() -> Acting:
        last: list[float] = []

        def acting(moment: Moment, values: Array) -> Array:
            last[:] = [step(last[0], float(values[k])) if last else float(values[k])]
            values[k] = last[0]
            return values

        return acting

    return make


def _blinking(k: int) -> Callable[[], Acting]:
    """The first value in every other half second."""

    def make() -> Acting:
        held: list[float] = []

        def acting(moment: Moment, values: Array) -> Array:
            if _on(moment, 1.0):
                held[:] = held or [float(values[k])]
                values[k] = held[0]
            else:
                held.clear()
            return values

        return acting

    return make


def _clipped(value: float, most: float) -> float:
    return min(max(value, -most), most)


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
        "comes and goes at 1 Hz": _one(k, lambda m, y: math.nan if _on(m, 1.0) else y),
        "stands still at 1 Hz": _blinking(k),
        "fades": _one(k, lambda m, y: y * (1.0 - 0.5 * m.since / LASTING)),
        "has a coarse converter": _one(k, lambda m, y: size / 16.0 * round(16.0 * y / size)),
        "oscillates": _one(k, lambda m, y: y + 0.3 * size * math.sin(60.0 * m.since)),
        "spikes now and then": _one(k, lambda m, y: y + size * (m.number % 10 == 0)),
        "ends at half": _one(k, lambda m, y: _clipped(y, 0.5 * size)),
        "wraps": _one(k, lambda m, y: math.remainder(y, 0.5 * size)),
        "follows slowly": _followed(k, lambda last, y: last + 0.05 * (y - last)),
        "is off by a little": _one(k, lambda m, y: y + 5.0 * noise),
    }


def _both(*makes: Callable[[], Acting]) -> Callable[[], Acting]:
    """One after the other."""

    def make() -> Acting:
        each = [one() for one in makes]

        def acting(moment: Moment, values: Array) -> Array:
            for change in each:
                values = change(moment, values)
            return values

        return acting

    return make


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
        "readings older and older": Fault(reads=_growing(20)),
        "readings of every tenth sample": Fault(reads=_every(10)),
        "all sensors in turn": Fault(
            reads=_plain(lambda m, y: np.where(np.arange(len(y)) == m.number // 20 % len(y), -y, y))
        ),
        "all sensors twice": Fault(reads=_plain(lambda m, y: 2.0 * y)),
    }
    if len(rig.system.outputs) > 1:
        found |= {
            "two sensors stand still": Fault(reads=_both(_held(0, 0.0), _held(1, 0.0))),
            "two sensors flip": Fault(reads=_plain(lambda m, y: np.concatenate([-y[:2], y[2:]]))),
            "two sensors jump": Fault(reads=_plain(lambda m, y: np.concatenate([y[:2] + 0.5 * sizes[:2], y[2:]]))),
            "two sensors show nothing": Fault(reads=_plain(lambda m, y: np.concatenate([[math.nan] * 2, y[2:]]))),
            "two sensors are swapped": Fault(reads=_plain(lambda m, y: np.concatenate([y[1::-1], y[2:]]))),
            "one sensor after the other jumps": Fault(
                reads=_plain(lambda m, y: y + 0.5 * sizes * (np.arange(len(y)) == (m.since > 0.5)))
            ),
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
        "has a dead zone": _one(k, lambda m, u: u - _clipped(u, 0.05 * span)),
        "has backlash": _followed(k, lambda last, u: last + (u - last) - _clipped(u - last, 0.05 * span)),
        "is slow": _followed(k, lambda last, u: last + _clipped(u - last, 0.005 * span)),
        "ends at a tenth": _one(k, lambda m, u: _clipped(u, 0.1 * span)),
        "has coarse steps": _one(k, lambda m, u: 0.1 * span * round(10.0 * u / span)),
        "acts one way": _one(k, lambda m, u: max(u, 0.0)),
        "is noisy": _one(k, lambda m, u: u + 0.1 * span * m.random.standard_normal()),
        "has a quarter of its gain": _one(k, lambda m, u: 0.25 * u),
        "has three times its gain": _one(k, lambda m, u: 3.0 * u),
        "follows by a lag of 50 samples": _followed(k, lambda last, u: last + 0.02 * (u - last)),
        "flips and lags": _followed(k, lambda last, u: last + 0.2 * (-u - last)),
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
    found |= {
        "inputs are reported late": Fault(tells=_late(20)),
        "inputs are reported as 0": Fault(tells=_plain(lambda m, u: 0.0 * u)),
        "inputs are reported as 0, now and then": Fault(tells=_plain(lambda m, u: 0.0 * u if m.number % 5 == 0 else u)),
        "inputs are reported with the wrong sign": Fault(tells=_plain(lambda m, u: -u)),
        "inputs are reported by half": Fault(tells=_plain(lambda m, u: 0.5 * u)),
        "inputs are not reported": Fault(tells=_plain(lambda m, u: math.nan * u)),
        "inputs are reported now and then": Fault(tells=_plain(lambda m, u: math.nan * u if _on(m, 0.3) else u)),
        "inputs are reported with noise": Fault(
            tells=_plain(lambda m, u: u + 0.05 * rig.limits[1] * m.random.standard_normal(len(u)))
        ),
    }
    found["sensor and actuator stand still"] = Fault(reads=_held(0, 0.0), acts=_held(0, 0.0), told=False)
    return found
