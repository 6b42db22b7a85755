"""hybrid-sysid evaluate: how well a model predicts bags."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_sysid_ros import report as reports
from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.identification import Part, evaluate
from hybrid_sysid_ros.identification.validation.input_bias import adapt
from hybrid_sysid_ros.identification.validation.resimulation import resimulations
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_file


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    bag: Annotated[list[Path], typer.Argument(help="Bags to score it on.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    part: terminal.PartText = "0:1",
    adapted: Annotated[
        float,
        typer.Option(
            "--adapt",
            help="Estimate a constant bias of each input over the first so many seconds, and score the free run over "
            "the rest without and with it; 0: not.",
            min=0.0,
        ),
    ] = 0.0,
    report: Annotated[Path | None, typer.Option(help="Write an HTML report with plots.")] = None,
    signals: terminal.SignalsFile = None,
    recover: terminal.Recover = False,
    read_period: terminal.ReadPeriod = 0.0,
    rig: terminal.OwnRig = "",
) -> None:
    """Score a model by strict free run: one initial state, never corrected. Where a bag has the reference, the whole
    closed loop is simulated again from it as well.
    """
    if report is not None:
        reports.check_available()
        check_file(report, suffix=".html")
    loaded = load_model(model, rig=rig)
    described = load_rig(loaded.rig)
    chosen = Part.parse(part)
    records = terminal.read_records(bag, loaded.rig, signals, recover, read_period, loaded.sampling)
    scores = {record.name: evaluate(loaded, record, part=chosen).content for record in records}
    low, high = described.limits
    shared: dict[str, Any] = {"sampling": loaded.sampling, "spans": high - low, "seconds": adapted}
    runs = {
        record.name: adapt(loaded.system, chosen.of(record, loaded.sampling), **shared)
        for record in (records if adapted else ())
    }
    biases = {name: run.content(loaded.system) for name, run in runs.items()}
    again, skipped = resimulations(
        loaded.system, [(record, chosen) for record in records], described, sampling=loaded.sampling
    )
    loops = {name: item.output.content for name, item in again.items()}
    for reason in skipped.values():
        status.print(f"no closed loop: {reason}")
    if report is not None:
        section = reports.identification_section(loaded, [(record, chosen) for record in records], runs)
        reports.write(report, section, None, reports.provenance(loaded, " ".join(sys.argv)))
        status.print(str(report))
    if as_json:
        content = {name: {**values, "closed_loop": loops.get(name)} for name, values in scores.items()}
        for name, values in biases.items():
            content[name]["adapted"] = values
        console.print_json(json.dumps({"model": str(model), "part": part, "records": content}))
    else:
        print_table(terminal.score_table(scores, described, "free run", loops))
        if biases:
            print_table(terminal.bias_table(biases, described, adapted))
