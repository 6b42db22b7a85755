"""Faults of sensors and actuators in loops without a clock: python -m benchmarks.fault_rehearsal [RIG or FAULT...].

Estimator, guard and controller as the nodes use them, on the simulated rig, which follows a moving reference. It
repeats bit by bit, so that rules and thresholds can be tried; python -m benchmarks.faults asks real processes. Of each
fault, beside those of that benchmark some more: the first state that is not driving, and after how long; the strongest
evidence; whether travel and validity were kept until the loop was held or at rest; the largest tracking error during
the fault, and that of the second which begins a second after its end, both in tolerances.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.faults.distrust import SHARE, STUCK, sizes_of
from benchmarks.faults.observation import LONGEST_LOOK, MOVING, RESTRAINED, ROOM, WINDOW
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.guarded_loop import guarded_loop
from hybrid_sysid_ros.runtime.parameters import defaults, shipped
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NAME = "fault_rehearsal"
SETTLING, LASTING, AFTER = 2.0, 2.0, 1.0
"""Time of the way to the reference, of a fault, and after it [s]."""


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


def sensor_faults(rig: Rig, sizes: Array) -> dict[str, Fault]:
    """By name."""
    found: dict[str, Fault] = {}
    for k, (item, sensor) in enumerate(zip(rig.system.outputs, rig.sensors, strict=True)):
        size, noise = float(sizes[k]), abs(sensor.scale) * max(sensor.noise, 0.0)
        count = abs(sensor.scale) * (sensor.quantiser.count if sensor.quantiser else 0.1 * sensor.white_noise)
        kinds: dict[str, Callable[[], Acting]] = {
            "sign flips": _one(k, lambda m, y: -y),
            "gain .5": _one(k, lambda m, y: 0.5 * y),
            "dithers by a count": _held(k, 0.0, count),
            "stands still": _held(k, 0.0),
            "60 % spikes": _one(k, lambda m, y, size=size: y + size * float(m.random.random() < SHARE)),  # type: ignore[misc]
            "drifts": _one(k, lambda m, y, size=size: y + size * m.since / LASTING),  # type: ignore[misc]
            "no number": _one(k, lambda m, y: math.nan),
            # kinds of their own
            "stands still with noise": _held(k, noise),
            "shows noise alone": _one(k, lambda m, y, noise=noise: noise * m.random.standard_normal()),  # type: ignore[misc]
            "gain drifts to 2": _one(k, lambda m, y: y * (1.0 + m.since / LASTING)),
            "gain -.3": _one(k, lambda m, y: -0.3 * y),
            "drifts slowly": _one(k, lambda m, y, size=size: y + 0.25 * size * m.since / LASTING),  # type: ignore[misc]
            "jumps": _one(k, lambda m, y, size=size: y + 0.5 * size),  # type: ignore[misc]
            "jumps to and fro": _one(k, lambda m, y, size=size: y + size * _on(m, 0.2)),  # type: ignore[misc]
            "comes and goes": _one(k, lambda m, y: math.nan if _on(m, 0.3) else y),
            "flips to and fro": _one(k, lambda m, y: -y if _on(m, 0.3) else y),
            "is ten times as noisy": _one(k, lambda m, y, noise=noise: y + 10 * noise * m.random.standard_normal()),  # type: ignore[misc]
            "is at its end": _one(k, lambda m, y, size=size: 2.5 * size),  # type: ignore[misc]
        }
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


def actuator_faults(rig: Rig) -> dict[str, Fault]:
    """By name."""
    found: dict[str, Fault] = {}
    for k, (item, actuator) in enumerate(zip(rig.system.inputs, rig.actuators, strict=True)):
        stuck, span = STUCK * actuator.high, actuator.high - actuator.low
        kinds: dict[str, Callable[[], Acting]] = {
            "flips": _one(k, lambda m, u: -u),
            "is stuck": _one(k, lambda m, u, stuck=stuck: stuck),  # type: ignore[misc]
            "is disconnected": _one(k, lambda m, u: 0.0),
            # kinds of their own
            "has half its gain": _one(k, lambda m, u: 0.5 * u),
            "has twice its gain": _one(k, lambda m, u: 2.0 * u),
            "stands still": _held(k, 0.0),
            "is stuck low": _one(k, lambda m, u, stuck=stuck: -stuck),  # type: ignore[misc]
            "comes and goes": _one(k, lambda m, u: 0.0 if _on(m, 0.3) else u),
            "flips to and fro": _one(k, lambda m, u: -u if _on(m, 0.3) else u),
            "hunts": _one(k, lambda m, u, span=span: u + 0.3 * span * (1.0 if _on(m, 0.2) else -1.0)),  # type: ignore[misc]
            "is off by a tenth": _one(k, lambda m, u, span=span: u + 0.1 * span),  # type: ignore[misc]
            "creeps away": _one(k, lambda m, u, span=span: u + 0.5 * span * m.since / LASTING),  # type: ignore[misc]
            "loses its gain": _one(k, lambda m, u: u * (1.0 - m.since / LASTING)),
        }
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


class Rehearsal:
    """A loop of a rig, of which each fault is tried on a fresh one."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        model = load_model(shipped(rig.name, "model"), rig=rig.source)
        self.loop = guarded_loop(rig, model, {"policy": "supervised", "certificate": "ignore"})
        self.estimator, self.period = self.loop.estimator, 1.0 / defaults(rig, "estimator")["rate"]
        self.tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
        self.learned = math.ceil(min(1.0 / MOVING[rig.name]["frequency"], LONGEST_LOOK) / WINDOW) * WINDOW
        self.before = SETTLING + self.learned
        scales = np.array([display.scale for display in rig.display])
        amplitude, turns = MOVING[rig.name]["amplitude"], 2.0 * math.pi * MOVING[rig.name]["frequency"]
        self._peaks, self._turns = scales * amplitude * self.tracked, turns
        names = [item.name for item in rig.system.states]
        self._at = [(k, names.index(item.name)) for k, item in enumerate(rig.system.outputs) if item.name in names]

    def reference(self, times: Array) -> Array:
        """(times, p) [SI]."""
        return np.sin(self._turns * np.asarray(times))[..., None] * self._peaks

    def tried(self, fault: Fault, *, seed: int = 0) -> dict[str, Any]:
        """What the loop did."""
        rig, loop, estimator, period = self.rig, self.loop, self.estimator, self.period
        plant = Plant(rig, seed=seed, bias=rig.bias)
        estimator.begin()
        loop.begin()
        steps, random = rig.steps(period, "the period"), np.random.default_rng(seed)
        reads = fault.reads() if fault.reads else None
        acts = fault.acts() if fault.acts else None
        applied, told = loop.input.copy(), loop.input.copy()
        errors: list[Array] = []
        low, high = rig.limits
        found: dict[str, Any] = {
            "state": "",
            "after": math.inf,
            "left": math.inf,
            "restrained": math.inf,
            "most": 0.0,
            "reason": "",
        }
        tripped = ""
        for k in range(round((self.before + LASTING + AFTER + WINDOW) / period)):
            time = k * period
            since = time - self.before
            moment = Moment(since, k - round(self.before / period), random)
            wrong = 0.0 <= since < LASTING
            readings = plant.sensed().copy()
            errors.append((self.reference(np.array([time]))[0] - plant.outputs()) * self.tracked)
            if wrong and reads is not None:
                readings = reads(moment, readings)
            estimate = estimator.update(time, readings, told)
            now = time + loop.lead
            command = loop.control(
                estimate, told, self.reference(np.array([now]))[0], self.reference(now + loop.times), period
            )
            told = np.array([item.bounded(float(u)) for item, u in zip(rig.actuators, command, strict=True)])
            applied = told.copy()
            if wrong and acts is not None:
                applied = np.clip(acts(moment, applied), low, high)
                told = applied.copy() if fault.told else told
            for _ in range(steps):
                plant.advance(applied)
            level = loop.level
            if since < 0.0 and level is not LoopState.DRIVING:
                tripped = level.word
            if since >= 0.0:
                if level is not LoopState.DRIVING and not found["state"]:
                    found |= {"state": level.word, "after": since, "reason": loop.guard.reason}
                if level.word in RESTRAINED:
                    found["restrained"] = min(found["restrained"], since)
                found["most"] = max(found["most"], *loop.guard.evidence.values())
                found["left"] = min(found["left"], since) if self._is_out(plant) else found["left"]
        rows, count = np.array(errors), round(WINDOW / period)

        def rms(begin: float) -> Array:
            return np.sqrt(np.mean(rows[round(begin / period) :][:count] ** 2, axis=0))

        usual = np.max([rms(SETTLING + j * WINDOW) for j in range(round(self.learned / WINDOW))], axis=0)
        noise = np.array([sensor.scale * sensor.noise for sensor in rig.sensors])
        tolerance = np.where(self.tracked, ROOM * np.maximum(usual, noise), math.inf)
        during = np.max(np.abs(rows[round(self.before / period) : round((self.before + LASTING) / period)]), axis=0)
        found["during"] = float(np.max(during / tolerance))
        found["error"] = float(np.max(rms(self.before + LASTING + AFTER) / tolerance))
        found["kept"] = min(found["restrained"], LASTING + AFTER) <= found["left"]
        found["false"] = tripped
        found["short"] = not found["kept"] or not found["error"] <= 1.0
        return found

    def _is_out(self, plant: Plant) -> bool:
        outputs = plant.outputs()
        bounds = [self.rig.travel, *([] if self.rig.validity is None else [self.rig.validity])]
        return any(not low[s] <= outputs[k] <= high[s] for low, high in bounds for k, s in self._at)


def main() -> int:
    """Try all, or those that are named."""
    asked, tables = sys.argv[1:], dict[str, dict[str, dict[str, Any]]]()
    known: dict[str, Mapping[str, Fault]] = {}
    for name in MOVING:
        rig = load(name)
        known[name] = {**sensor_faults(rig, sizes_of(rig, dict(MOVING[name]))), **actuator_faults(rig)}
    names = {fault for faults in known.values() for fault in faults}
    for word in asked:
        if word not in names and word not in known:
            raise UserError(f"no rig or fault {word!r}: rigs are {', '.join(known)}, faults {', '.join(sorted(names))}")
    for name, faults in known.items():
        wanted = {fault: each for fault, each in faults.items() if not asked or name in asked or fault in asked}
        if not wanted or (set(asked) & known.keys() and name not in asked):
            continue
        rehearsal, tables[name] = Rehearsal(load(name)), {}
        for fault, each in wanted.items():
            status.print(f"{name}: {fault}")
            tables[name][fault] = rehearsal.tried(each)
        print_table(_table(name, tables[name]))
    every = [row for rows in tables.values() for row in rows.values()]
    short = sum(row["short"] for row in every)
    print(f"{short} of {len(every)} fall short")
    if not asked:
        print(result.write(NAME, {**tables, "short": short, "faults": len(every)}))
    return 0


def _table(rig: str, rows: Mapping[str, Mapping[str, Any]]) -> Table:
    table = Table(
        "fault",
        "state",
        "after [s]",
        "evidence",
        "kept",
        "during",
        "after",
        "because",
        title=f"faults on {rig}, without a clock",
    )
    for name, row in rows.items():
        kept = "yes" if row["kept"] else "NO"
        times = [f"{row[key]:.2f}" for key in ("after", "most")]
        errors = [f"{row[key]:.2f}" for key in ("during", "error")]
        table.add_row(
            f"{name}{'  <- short' if row['short'] else ''}", row["state"], *times, kept, *errors, row["reason"]
        )
    return table


if __name__ == "__main__":
    result.run(main)
