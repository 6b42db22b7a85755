"""The study of the record: a law of torque over speed, learnt from its first half and run freely over the second."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.identification import Part, identify
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import written_file
from studies.drill_string.records import RPM, load

Array = NDArray[np.float64]

RIG = Path(__file__).parent / "turned_top"
SAMPLING = Sampling(step=0.002, period=0.01)
LEARNT, KEPT = Part(stop=0.5), Part(start=0.5)
STUCK = 0.2
"""Speed of a bit that is stuck [rad/s], as the source's table of torque over speed has it."""
SPEEDS = (0.2, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 21.0)
"""Bounds of speed over which the mean torque is shown [rad/s]."""
STRUCTURES = ("gray", "hybrid")
STARTS = 8

Folder = Annotated[Path, typer.Argument(help="Folder that holds drillstring/175_completo_1.mat, or that file.")]
Out = Annotated[Path, typer.Option(help="Where the numbers go, as JSON.")]


def command(folder: Folder, out: Out = Path("out/drill_string_record.json")) -> None:
    """Clean the public record, learn from its first half, and report the free run over the second."""
    record, cleaning = load(folder)
    structures: dict[str, Any] = {}
    rig = load_rig(RIG)
    for structure in STRUCTURES:
        model = identify([record], rig, structure, sampling=SAMPLING, part=LEARNT, options={"starts": STARTS})
        told = {"fit_seconds": model.fit["seconds"], "parameters": model.system.named}
        structures[structure] = {**judged(model, record), **told}
    found = {
        "cleaning": asdict(cleaning),
        "torque_over_speed": torque_over_speed(record),
        "structures": structures,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    with written_file(out) as partial:
        partial.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    line = f"{cleaning.spikes} negative spikes of {len(record.time)} samples' top speed, down to "
    line += f"{cleaning.lowest / RPM:.0f} rpm: {cleaning.negative} samples below zero, {100 * cleaning.replaced:.1f} % "
    console.print(f"{line}replaced with their flanks, the longest piece of {cleaning.longest:.3f} s")
    print_table(table(found))
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
        "stuck": found_stuck(experiment.outputs[:, 0], simulated[:, 0]),
    }


def found_stuck(measured: Array, simulated: Array) -> dict[str, float]:
    """Precision and recall of stuck samples, and their share."""
    truth, told = np.abs(measured) < STUCK, np.abs(simulated) < STUCK
    both = float(np.sum(truth & told))
    return {
        "precision": both / max(float(told.sum()), 1.0),
        "recall": both / max(float(truth.sum()), 1.0),
        "share": float(truth.mean()),
    }


def table(found: dict[str, Any]) -> Table:
    """Scores of each structure."""
    headings = "R2 bit speed", "R2 torque", "RMSE bit speed [rad/s]", "RMSE torque [N m]", "precision", "recall"
    shown = Table("", *headings, title="second half, strict free run from the top's speed alone")
    for name, row in found["structures"].items():
        values = [*row["r2"].values(), *row["rmse"].values(), row["stuck"]["precision"], row["stuck"]["recall"]]
        shown.add_row(name, *(f"{value:.3f}" for value in values))
    return shown
