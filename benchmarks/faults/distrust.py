"""Faults of sensors and actuators that look like sound ones: what a loop must find out by itself."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from benchmarks.faults.measurements import Change, changed
from benchmarks.faults.stage import LASTING, Fault, Stage
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

ReadingChange = Callable[[float], float]
"""Makes a reading of the true one; of one fault alone, for it may remember."""
Acting = Callable[[Array], Array]
"""Makes of the commanded inputs (m,) what acts."""
DOUBTED = "contradict|left out|innovations|does not believe|not as large"
"""What is said of a sensor that the model does not believe."""
UNDONE = "does not do what was commanded"
"""What is said of an actuator that says what it does; of one that does not only the sensors can tell."""
QUIET = {"winged_cone": {"pitch_rate"}}
"""By rig, outputs that the moving reference leaves within their noise: with the sign turned they tell the same."""
SHARE, STUCK = 0.6, 0.8
"""Of readings that spike, and of its range at which an actuator is stuck."""


def _rewritten(place: SignalPlace, make: Callable[[], ReadingChange]) -> Callable[[], Change]:
    """Measurements one number of which is another one."""

    def begin() -> Change:
        value = make()

        def change(message: JointState) -> list[JointState]:
            numbers, index = getattr(message, place.field), list(message.name).index(place.entry)
            if index < len(numbers):
                numbers[index] = value(numbers[index])
            return [message]

        return change

    return begin


def _sensor(place: SignalPlace, make: Callable[[], ReadingChange]) -> Fault:
    def fault(stage: Stage) -> None:
        with changed(stage, _rewritten(place, make)()):
            time.sleep(LASTING)

    return fault


def _dithered(count: float) -> Callable[[], ReadingChange]:
    """About the first reading, by a count from one to the next."""

    def make() -> ReadingChange:
        held: list[float] = []

        def reading(value: float) -> float:
            held.append(held[0] if held else value)
            return held[0] + count * (len(held) % 2)

        return reading

    return make


def _spiking(size: float) -> Callable[[], ReadingChange]:
    def make() -> ReadingChange:
        draw = random.Random(0)
        return lambda value: value + size * (draw.random() < SHARE)

    return make


def _drifting(rate: float) -> Callable[[], ReadingChange]:
    """Off by more and more [unit/s]."""

    def make() -> ReadingChange:
        began = time.monotonic()
        return lambda value: value + rate * (time.monotonic() - began)

    return make


def sensors(rig: Rig, stage_outputs: list[SignalPlace], sizes: Array) -> dict[str, tuple[Fault, str]]:
    """Faults of each sensor, whose readings usually reach sizes (p,)."""
    found: dict[str, tuple[Fault, str]] = {}
    for place, item, sensor, size in zip(stage_outputs, rig.system.outputs, rig.sensors, sizes.tolist(), strict=True):
        count = abs(sensor.scale) * (sensor.quantiser.count if sensor.quantiser else 0.1 * sensor.white_noise)
        still = "times the same reading|left out|slowed|missing"
        kinds: dict[str, tuple[Callable[[], ReadingChange], str]] = {
            "sign flips": (lambda: lambda value: -value, "" if item.name in QUIET.get(rig.name, ()) else DOUBTED),
            "gain .5": (lambda: lambda value: 0.5 * value, ""),
            "dithers by a count": (_dithered(count), still if sensor.noisy else DOUBTED),
            "stands still": (_dithered(0.0), still if sensor.noisy else DOUBTED),
            "60 % spikes": (_spiking(size), DOUBTED),
            "drifts": (_drifting(size / LASTING), ""),
            "no number": (lambda: lambda value: float("nan"), "not a number|missing|no number"),
        }
        for name, (make, words) in kinds.items():
            found[f"{item.name} {name}"] = _sensor(place, make), words
    return found


def _actuator(index: int, acting: Acting, *, told: bool) -> Fault:
    """One input acts otherwise; told: measurements say how it acts, otherwise what was commanded."""

    def fault(stage: Stage) -> None:
        place, commanded = stage.inputs[index], [0.0]

        def act(message: JointState) -> list[JointState]:
            at = list(message.name).index(place.entry)
            commanded[0] = message.effort[at]
            message.effort[at] = float(acting(np.array([commanded[0]]))[0])
            return [message]

        def tell(message: JointState) -> list[JointState]:
            if not told:
                message.effort[list(message.name).index(place.entry)] = commanded[0]
            return [message]

        stage.actuators.change = act
        with changed(stage, tell):
            time.sleep(LASTING)
        stage.actuators.change = None

    return fault


def actuators(rig: Rig) -> dict[str, tuple[Fault, str]]:
    """Faults of each actuator."""
    found: dict[str, tuple[Fault, str]] = {}
    for k, (item, actuator) in enumerate(zip(rig.system.inputs, rig.actuators, strict=True)):
        stuck = STUCK * actuator.high
        kinds: dict[str, Acting] = {
            "flips": lambda u: -u,
            "is stuck": lambda u, value=stuck: np.full(1, value),  # type: ignore[misc]
            "is disconnected": lambda u: np.zeros(1),
        }
        for name, acting in kinds.items():
            found[f"{item.name} {name}"] = _actuator(k, acting, told=True), UNDONE
            found[f"{item.name} {name}, unreported"] = _actuator(k, acting, told=False), ""
    return found


def sizes_of(rig: Rig, reference: dict[str, Any]) -> Array:
    """How large readings are in a spike or a drift (p,) [SI]: the reference's amplitude, or a hundred deviations of the
    noise of outputs that are not tracked.
    """
    amplitude = np.array(reference["amplitude"]) * [display.scale for display in rig.display]
    noise = np.array([abs(s.scale) * max(s.noise, s.quantiser.count if s.quantiser else 0.0) for s in rig.sensors])
    return np.asarray(np.maximum(np.abs(amplitude), 100.0 * noise))
