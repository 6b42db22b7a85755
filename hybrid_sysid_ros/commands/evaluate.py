"""hybrid-sysid evaluate: how well a model predicts bags."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros import report as reports
from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.identification import Part, evaluate
from hybrid_sysid_ros.identification.validation.resimulation import resimulations
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_file


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    bag: Annotated[list[Path], typer.Argument(help="Bags to score it on.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    part: terminal.PartText = "0:1",
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
    again, skipped = resimulations(
        loaded.system, [(record, chosen) for record in records], described, sampling=loaded.sampling
    )
    loops = {name: item.output.content for name, item in again.items()}
    for reason in skipped.values():
        status.print(f"no closed loop: {reason}")
    if report is not None:
        section = reports.identification_section(loaded, [(record, chosen) for record in records])
        reports.write(report, section, None, reports.provenance(loaded, " ".join(sys.argv)))
        status.print(str(report))
    if as_json:
        content = {name: {**values, "closed_loop": loops.get(name)} for name, values in scores.items()}
        console.print_json(json.dumps({"model": str(model), "part": part, "records": content}))
    else:
        print_table(terminal.score_table(scores, described, "free run", loops))
