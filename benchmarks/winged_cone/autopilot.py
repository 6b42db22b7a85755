"""The autopilot on plants with the uncertain parameters at all their corners, and anywhere between; and with its
feed-forward scheduled by what was identified of each plant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.winged_cone import flights
from benchmarks.winged_cone.identification import fitted
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.trim.feed_forward import scheduled
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

RANDOM = 236
"""Plants beside the corners."""
STEPS = {"speed": 30.48, "height": 609.6}
"""Commands of the followed outputs [m/s, m]."""
MANOEUVRES: Mapping[str, tuple[str, ...]] = {
    "both": ("speed", "height"),
    "speed alone": ("speed",),
    "height alone": ("height",),
}
"""Which of them step, at once."""
STATES = {"speed": 0, "height": 2}
SECONDS = 90.0
"""Flown after the step."""
BAND = 0.02
ANGLE_OF_ATTACK = 3
CORNERS = 2 ** len(flights.UNCERTAIN)
IDENTIFIED = "known_air"


def drawn(system: System) -> Iterator[System]:
    """All corners of the uncertain parameters, and plants between them."""
    for corner in product((-1.0, 1.0), repeat=len(flights.UNCERTAIN)):
        yield flights.with_values(system, dict(zip(flights.UNCERTAIN, corner, strict=True)))
    for seed in range(RANDOM):
        yield flights.plant(system, seed)


def judged(time: Array, values: Array, step: float) -> tuple[float, float]:
    """Settling time within 2 % [s], the whole time where it does not, and overshoot [unit of the values]."""
    away = np.flatnonzero(np.abs(values - step) > BAND * abs(step))
    last = time[min(away[-1] + 1, len(time) - 1)] if len(away) else 0.0
    return float(last), float(max(np.max(values) - step, 0.0))


def measured(rig: Rig) -> dict[str, Any]:
    """All plants under the rig's own feedback."""
    plants = list(drawn(rig.system))
    return flown(plants, [rig] * len(plants))


def scheduled_measured(rig: Rig) -> dict[str, Any]:
    """The corners, each with the feed-forward of a model that one record of it taught."""
    assert rig.experiments.feedback is not None
    plants, rigs = list(drawn(rig.system))[:CORNERS], []
    for number, plant in enumerate(plants):
        model, _ = fitted(rig, plant, IDENTIFIED, number)
        feedback = scheduled(rig.experiments.feedback, model.system)
        rigs.append(replace(rig, experiments=replace(rig.experiments, feedback=feedback)))
    return flown(plants, rigs)


def flown(plants: Sequence[System], rigs: Sequence[Rig]) -> dict[str, Any]:
    """Each manoeuvre on plants, each under the feedback of its rig, with the sensors' noise; judged by the true states,
    from the step on.
    """
    found: dict[str, Any] = {}
    rig = rigs[0]
    for name, moved in MANOEUVRES.items():
        signals = flights.steps(rig, {output: STEPS[output] for output in moved}, SECONDS)
        runs = [
            flights.fly(own, system, signals, seed=number).since(flights.SETTLING)
            for number, (own, system) in enumerate(zip(rigs, plants, strict=True))
        ]
        offset = rig.system.operating_point["angle_of_attack"]
        angles = np.degrees(np.array([flight.states[:, ANGLE_OF_ATTACK] for flight in runs]) + offset)
        row: dict[str, Any] = {"plants": len(plants), "angle_of_attack": [float(angles.min()), float(angles.max())]}
        for output in moved:
            values = [flight.states[:, STATES[output]] for flight in runs]
            settling, overshoot = zip(*(judged(runs[0].time, each, STEPS[output]) for each in values), strict=True)
            row[output] = {
                "held": sum(time < SECONDS - 1.0 for time in settling),
                "settling": {"median": float(np.median(settling)), "max": max(settling)},
                "overshoot": max(overshoot),
                "overshoot_share": max(overshoot) / STEPS[output],
            }
        found[name] = row
    return found


def table(found: dict[str, Any]) -> Table:
    """What each manoeuvre came to."""
    shown = Table(
        "steps", "of", "plants held", "settling: median", "longest [s]", "overshoot [%]", "angle of attack [deg]"
    )
    for name, row in found.items():
        low, high = row["angle_of_attack"]
        for output in MANOEUVRES[name]:
            own = row[output]
            shown.add_row(
                name, output, f"{own['held']} of {row['plants']}", f"{own['settling']['median']:.1f}",
                f"{own['settling']['max']:.1f}", f"{100 * own['overshoot_share']:.2f}", f"{low:.2f} to {high:.2f}",
            )  # fmt: skip
    return shown
