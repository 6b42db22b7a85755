"""Identification under the loop: what the data tell, and how the models predict flights that no fit saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.winged_cone import flights
from benchmarks.winged_cone.flights import Flight
from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.core.wrappers import feedback_of
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.parameter_groups import ParameterGroup
from hybrid_sysid_ros.models import Model, Options, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

BOXES = ("constant_air", "known_air")
SEEDS = (0, 1, 2)
SAMPLING = Sampling(step=0.02, period=0.02)
SECONDS = 300.0
"""Of a record, behind the settling."""
SPEED, HEIGHT = 30.48, 609.6
MANOEUVRES: Mapping[str, Mapping[str, float]] = {
    "V": {"speed": SPEED},
    "h": {"height": HEIGHT},
    "V+h": {"speed": SPEED, "height": HEIGHT},
    "1.5x": {"speed": 1.5 * SPEED, "height": 1.5 * HEIGHT},
    "-1.5x": {"speed": -1.5 * SPEED, "height": -1.5 * HEIGHT},
    "2x": {"speed": 2.0 * SPEED, "height": 2.0 * HEIGHT},
}
HORIZONS = {"K1": (1.0, False), "K5": (5.0, False), "K20": (20.0, True)}
"""Seconds ahead, and whether the stabiliser closes the simulation."""
FLOWN, APART = 60.0, 0.5
"""Seconds of a manoeuvre, and from one beginning of a prediction to the next."""
GROUPS: Mapping[str, Mapping[str, float]] = {
    "rho S / m": {"density": 1.0, "area": 1.0, "mass": -1.0},
    "rho S c / I": {"density": 1.0, "area": 1.0, "chord": 1.0, "inertia": -1.0},
    "ce": {"elevator_moment": 1.0},
}
"""What the data tell, by the powers of parameters."""
REPEATED = 20
"""Records of plants that the model can be, each with other noise and parameters."""


def product_of(system: System, powers: Mapping[str, float]) -> float:
    """A group's value."""
    named = system.named
    return float(np.prod([named[name] ** power for name, power in powers.items()]))


def relative_error(model: Model, powers: Mapping[str, float]) -> float:
    """Its standard error, as part of its value."""
    named, names = model.system.named, list(model.names)
    weights = np.zeros(len(names))
    for name, power in powers.items():
        weights[names.index(name)] = power / named[name]
    return float(np.sqrt(weights @ model.covariance @ weights))


def outputs_of(system: System, states: Array) -> Array:
    """The states that are outputs, (samples, outputs)."""
    return np.ascontiguousarray(states[:, list(system.measured)])


def ahead(system: System, rig: Rig, flight: Flight, seconds: float, closed: bool) -> Array:
    """Root mean square errors of the outputs so far ahead of true states, (outputs,)."""
    length, stride = round(seconds / SAMPLING.period), round(APART / SAMPLING.period)
    begins = np.arange(0, len(flight.time) - length, stride)
    starts = np.array([[0, b, length + 1, k * (length + 1)] for k, b in enumerate(begins)])
    truth, inputs, feedback = outputs_of(system, flight.states), flight.inputs, None
    if closed:
        assert rig.experiments.stabiliser is not None
        inputs = inputs + truth[:-1] @ rig.experiments.stabiliser.T
        feedback = feedback_of(system, rig.experiments.stabiliser)
    first = np.ascontiguousarray(flight.states[begins])
    _, found = rollouts(system, starts, first, np.ascontiguousarray(inputs), step=SAMPLING.step, feedback=feedback)
    return np.asarray(np.sqrt(np.mean((found[starts[:, 3] + length] - truth[begins + length]) ** 2, axis=0)))


def scores(system: System, rig: Rig, plant: System, deviation: Array) -> dict[str, dict[str, float]]:
    """By manoeuvre and horizon the errors of all outputs in the deviations of the training record, root mean square.

    CL: of the whole manoeuvre flown by the feedback on the model, beside that on the plant.
    """
    found: dict[str, dict[str, float]] = {}
    for name, levels in MANOEUVRES.items():
        signals = flights.steps(rig, levels, FLOWN)
        whole = flights.fly(rig, plant, signals)
        flight = whole.since(flights.SETTLING)
        row = {
            key: float(np.sqrt(np.mean((ahead(system, rig, flight, *horizon) / deviation) ** 2)))
            for key, horizon in HORIZONS.items()
        }
        again = flights.fly(rig, system, signals).since(flights.SETTLING)
        error = outputs_of(system, again.states) - outputs_of(plant, flight.states)
        row["CL"] = float(np.sqrt(np.mean(np.mean(error**2, axis=0) / deviation**2)))
        found[name] = row
    return found


def fitted(rig: Rig, plant: System, structure: str, seed: int, options: Options | None = None) -> tuple[Model, Array]:
    """A model of one record, and the deviations of its outputs. seed: of the record, its noise and the fit."""
    signals = flights.experiment(rig, "flight", seed, flights.SETTLING + SECONDS)
    flight = flights.fly(rig, plant, signals, seed=seed).since(flights.SETTLING)
    record = flight.record(rig, f"flight_{seed}")
    model = identify([record], rig, structure, sampling=SAMPLING, options=options, seed=seed)
    return model, np.std(outputs_of(plant, flight.states), axis=0)


def reported(model: Model, plant: System) -> dict[str, dict[str, float]]:
    """Of each group the error beside the plant's value, and its standard error [%]."""
    return {
        name: {
            "error": 100.0 * (product_of(model.system, powers) / product_of(plant, powers) - 1.0),
            "standard_error": 100.0 * relative_error(model, powers),
        }
        for name, powers in GROUPS.items()
    }


def measured(rig: Rig) -> dict[str, Any]:
    """On plants that the models can't be, and on ones that one of them can."""
    boxes: dict[str, Any] = {}
    for box in BOXES:
        runs = []
        for seed in SEEDS:
            plant = flights.plant(rig.system, 100 + seed)
            model, deviation = fitted(rig, plant, box, seed)
            runs.append(
                {
                    "groups": reported(model, plant),
                    "chi_squared": model.fit["chi_squared"],
                    "seconds": model.fit["seconds"],
                    "scores": scores(model.system, rig, plant, deviation),
                }
            )
        boxes[box] = {
            "runs": runs,
            "scores": {
                name: {key: result.spread([run["scores"][name][key] for run in runs]) for key in (*HORIZONS, "CL")}
                for name in MANOEUVRES
            },
            "chi_squared": result.spread([run["chi_squared"] for run in runs]),
            "seconds": result.spread([run["seconds"] for run in runs]),
        }
    return {"boxes": boxes, "model_class": _in_class(rig)}


def _in_class(rig: Rig) -> dict[str, Any]:
    """Records of plants that are of the model's own equation: how far the groups are off, in standard errors."""
    own = rig.structures["known_air"]
    away: dict[str, list[float]] = {name: [] for name in GROUPS}
    found: list[str] = []
    for seed in range(REPEATED):
        plant = flights.plant(own, 200 + seed)
        model, _ = fitted(replace(rig), plant, "known_air", 300 + seed)
        for name, row in reported(model, plant).items():
            away[name].append(row["error"] / row["standard_error"])
        found.append("; ".join(str(ParameterGroup(**group)) for group in model.fit["groups"]))
    within = np.mean([abs(value) <= 3.0 for values in away.values() for value in values])
    return {"records": REPEATED, "within_3": float(within), "standard_errors": away, "groups": found}


def tables(found: Mapping[str, Any]) -> list[Table]:
    """Errors ahead and in closed loop, and the groups."""
    shown = []
    for box, row in found["boxes"].items():
        table = Table("", *HORIZONS, "CL", title=f"{box}: errors in training deviations, {len(SEEDS)} plants")
        for name, values in row["scores"].items():
            cells = (f"{each['mean']:.4f} ({each['min']:.4f}-{each['max']:.4f})" for each in values.values())
            table.add_row(name, *cells)
        shown.append(table)
        table = Table("plant", "chi2", *GROUPS, title=f"{box}: what the data tell [%], error +- standard error")
        for number, run in enumerate(row["runs"]):
            cells = (f"{each['error']:+.3f} +- {each['standard_error']:.3f}" for each in run["groups"].values())
            table.add_row(str(number), f"{run['chi_squared']:.2f}", *cells)
        shown.append(table)
    own = found["model_class"]
    title = f"{own['records']} plants of the model's own equation"
    table = Table("group", "largest error [standard errors]", title=title)
    for name, values in own["standard_errors"].items():
        table.add_row(name, f"{max(map(abs, values)):.2f}")
    table.add_row("within 3", f"{100 * own['within_3']:.1f} %")
    return [*shown, table]
