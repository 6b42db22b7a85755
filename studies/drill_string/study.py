"""The study of the record: a law of torque over speed, learnt from its first half and run freely over the second, and
an observer of the bit's speed, which nobody measures there.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_file, written_file
from studies.drill_string import observer, stops
from studies.drill_string.choice import FilterNoises, Folder
from studies.drill_string.records import KEPT, LEARNT, RPM, SAMPLING, load
from studies.drill_string.stops import STUCK

RIG = Path(__file__).parent / "turned_top"
SPEEDS = (0.2, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 21.0)
"""Bounds of speed over which the mean torque is shown [rad/s]."""
STRUCTURES = ("gray", "hybrid")
STARTS = 8

Out = Annotated[Path, typer.Option(help="JSON file for the results.")]


def command(folder: Folder, out: Out = Path("out/drill_string_record.json")) -> None:
    """Clean the public record, learn from its first half, and report the free run over the second."""
    check_file(out, suffix=".json")
    record, cleaning = load(folder)
    structures: dict[str, Any] = {}
    rig = load_rig(RIG)
    for structure in STRUCTURES:
        model = identify([record], rig, structure, sampling=SAMPLING, part=LEARNT, options={"starts": STARTS})
        reported = {"fit_seconds": model.fit["seconds"], "parameters": model.system.named}
        structures[structure] = {**judged(model, record), **reported}
    found = {
        "cleaning": asdict(cleaning),
        "torque_over_speed": torque_over_speed(record),
        "structures": structures,
        "observer": observed(record),
    }
    with written_file(out) as partial:
        partial.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    line = f"{cleaning.spikes} negative spikes of {len(record.time)} samples' top speed, down to "
    line += f"{cleaning.lowest / RPM:.0f} rpm: {cleaning.negative} samples below zero, {100 * cleaning.replaced:.1f} % "
    console.print(f"{line}replaced with their flanks, the longest piece of {cleaning.longest:.3f} s")
    console.print(f"{cleaning.returned:.1f} rad that these pieces turn too far are taken off around them")
    print_table(table(found))
    print_table(stuck_table(found))
    console.print(str(out))


def torque_over_speed(record: Record) -> list[float]:
    """Mean torque [N m] of the samples of each range of speed."""
    speed, torque = np.abs(record.output[:, 0]), record.output[:, 1]
    bounds = [0.0, *SPEEDS]
    return [float(torque[(speed >= low) & (speed < high)].mean()) for low, high in zip(bounds, SPEEDS, strict=False)]


def judged(model: Model, record: Record) -> dict[str, Any]:
    """The strict free run over the part that no fit saw, and the stuck samples that it finds there."""
    experiment = prepare(KEPT.of(record, SAMPLING), model.system, SAMPLING)
    simulated = free_run(model.system, experiment)
    names = [item.name for item in model.system.outputs]
    scores = Scores.of(names, experiment.outputs, simulated)
    return {
        "r2": {name: item.r2 for name, item in scores.outputs.items()},
        "rmse": {name: item.rmse for name, item in scores.outputs.items()},
        "stuck": stops.found(np.abs(experiment.outputs[:, 0]) < STUCK, np.abs(simulated[:, 0]) < STUCK),
    }


def observed(record: Record) -> dict[str, Any]:
    """The observer, identified and chosen on the first half: R2 of the bit's speed and stuck samples in either. It runs
    from the record's beginning on, as one on a rig does: in the midst of stick-slip it needs 5 s to find the twist.
    """
    learnt = LEARNT.of(record, SAMPLING)
    system, balance = observer.identified(learnt)
    found: dict[str, Any] = {"balance": asdict(balance), "parameters": system.named, "choice": asdict(FilterNoises())}
    measured, speed = FilterNoises().estimated(system, observer.aligned(record, balance.delay))
    cut = round(learnt.duration / observer.PERIOD) + 1
    for name, half in (("first", slice(cut)), ("second", slice(cut, None))):
        scores = score(measured[half], speed[half])
        reported = stops.found(np.abs(measured[half]) < STUCK, np.abs(speed[half]) < FilterNoises().stuck_below)
        found[name] = {"r2": scores.r2, "rmse": scores.rmse, "stuck": reported}
    return found


def table(found: dict[str, Any]) -> Table:
    """Scores of each structure."""
    headings = "R2 bit speed", "R2 torque", "RMSE bit speed [rad/s]", "RMSE torque [N m]"
    shown = Table("", *headings, title="second half, strict free run from the top's speed alone")
    for name, row in found["structures"].items():
        shown.add_row(name, *(f"{value:.3f}" for value in (*row["r2"].values(), *row["rmse"].values())))
    return shown


def stuck_table(found: dict[str, Any]) -> Table:
    """Stuck samples and stops that each finds."""
    shown = Table("", "precision", "recall", "of stops", "recall", "R2 bit speed", title="stuck samples")
    seen = found["observer"]
    rows = {
        f"{name}, free run, second half": (row["stuck"], row["r2"]["bit_speed"])
        for name, row in found["structures"].items()
    }
    rows |= {f"observer, {half} half": (seen[half]["stuck"], seen[half]["r2"]) for half in ("first", "second")}
    for name, (stuck, r2) in rows.items():
        values = *(stuck[key] for key in ("precision", "recall", "stop_precision", "stop_recall")), r2
        shown.add_row(name, *(f"{value:.3f}" for value in values))
    return shown
