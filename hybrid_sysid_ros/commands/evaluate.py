"""hybrid-sysid evaluate: how well a model predicts bags."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros.commands import fit_options, options
from hybrid_sysid_ros.commands.inspections import Inspect, inspected, print_inspections
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.score_table import score_table
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.validation.evaluation import ModelEvaluation, evaluation
from hybrid_sysid_ros.identification.validation.unstable import PredictionErrors
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support import extensions

EXTENDED_BY = "inspections"


def command(
    model: options.ModelFolder,
    bag: Annotated[list[Path], typer.Argument(help="Bags to score the model on.")],
    as_json: options.Json = False,
    part: options.PartText = "0:1",
    report: Annotated[Path | None, typer.Option(help="Write an HTML report with plots.")] = None,
    initial: fit_options.Initial = None,
    initial_samples: fit_options.InitialSamples = None,
    warm_up: fit_options.WarmUp = None,
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    rig: options.OwnRig = "",
    inspections: Sequence[Inspect] = (),
) -> None:
    """Score a model by strict free run: one initial state, never corrected; it is found as in the model's fit, unless
    options say otherwise. Where a bag has the reference, the whole closed loop is re-simulated from it as well.
    """
    page = None if report is None else extensions.one("pages", "model", "--report needs the extension report")(report)
    loaded = load_model(model, rig=rig).started(initial=initial, initial_samples=initial_samples, warm_up=warm_up)
    described = load_rig(loaded.rig)
    chosen = Part.parse(part)
    records = read_records(bag, loaded.rig, signals, recover, read_period, loaded.sampling.input, model=loaded)
    parts = [(record, chosen) for record in records]
    further = inspected(inspections, loaded, parts, described)
    found = [evaluation(loaded, record, described, part=chosen) for record in records]
    for item in found if described.experiments.loops or described.experiments.feedback else ():
        if item.no_loop:
            status.print(f"no closed loop: {item.no_loop}")
    if page is not None:
        page.write(loaded, parts, further)
        status.print(str(report))
    if as_json:
        content = {item.name: item.content for item in found}
        for inspection in further:
            for name, own in inspection.content.items():
                content[name][inspection.name] = own
        console.print_json(json.dumps({"model": str(model), "part": part, "records": content}))
    else:
        _show(found, described)
        print_inspections(further)


def _show(found: Sequence[ModelEvaluation], rig: Rig) -> None:
    """Print what was found, what counts most first."""
    for line in (line for item in found for line in item.doubts):
        console.print(line)
    ahead = {item.name: item.ahead for item in found if item.ahead}
    loops = {item.name: item.loop for item in found if item.loop is not None}
    if followed := {name: loops[name] for name in ahead if name in loops}:
        print_table(score_table(followed, rig, "closed loop, from the commands alone"))
    if ahead:
        print_table(_ahead_table(ahead, rig))
    if scores := {item.name: item.scores for item in found if item.scores}:
        print_table(score_table(scores, rig, "free run", loops))
    for line in (line for item in found for line in item.judgements):
        console.print(line)
    if bands := {item.name: item.bands for item in found if item.bands}:
        print_table(_band_table(bands, rig))


def _band_table(bands: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]], rig: Rig) -> Table:
    """Table of what bands hold, and of their widths in the outputs' display units."""
    levels = list(next(iter(bands.values())))
    columns = [text for level in levels for text in (f"{float(level):.0%} band holds", "half width")]
    table = Table(
        "record", "output", *columns, title="bands of the free run, by parameters, inputs and training errors"
    )
    for record, found in bands.items():
        for item, display in zip(rig.system.outputs, rig.display, strict=True):
            cells = []
            for level in levels:
                own = found[level][item.name]
                cells += [f"{own['held']:.0%}", f"{float(display.shown(own['half'])):.3g} {display.unit}"]
            table.add_row(record, item.name, *cells)
    return table


def _ahead_table(ahead: Mapping[str, Sequence[PredictionErrors]], rig: Rig) -> Table:
    """Table of prediction errors by horizon, for each output in its display unit."""
    headings = (f"{item.name} [{display.unit}]" for item, display in zip(rig.system.outputs, rig.display, strict=True))
    table = Table("record", "ahead", "", *headings, title="RMSE of predictions, from states estimated just before")
    for record, rows in ahead.items():
        for row in rows:
            held = "closed by the stabiliser" if row.closed else "open"
            each = (row.scores.outputs or {rig.system.outputs[0].name: row.scores}).values()
            errors = (f"{float(display.shown(one.rmse)):.4g}" for one, display in zip(each, rig.display, strict=True))
            table.add_row(record, f"{row.seconds:.3g} s", held, *errors)
    return table
