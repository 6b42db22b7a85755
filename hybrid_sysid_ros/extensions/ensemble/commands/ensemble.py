"""hybrid-sysid ensemble: several models together on bags."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.ensemble.ensemble import DEVIATIONS, Ensemble, ensemble
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import load as load_model


def command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to score the models on.")],
    model: Annotated[list[Path], typer.Option("--model", help="A model folder; give two or more.")],
    as_json: options.Json = False,
    part: options.PartText = "0:1",
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    rig: options.OwnRig = "",
) -> None:
    """Score the mean of several models' free runs beside each of them, and tell whether their spread holds what was
    measured.
    """
    loaded = [load_model(folder, rig=rig) for folder in model]
    given = bag, loaded[0].rig, signals, recover, read_period, loaded[0].sampling.input
    records = read_records(*given, model=loaded[0])
    found = {record.name: ensemble(loaded, record, part=Part.parse(part)) for record in records}
    labels = [str(folder) for folder in model]
    if as_json:
        console.print_json(json.dumps({name: _content(item, labels) for name, item in found.items()}))
    else:
        print_table(_table(found, labels))


def _content(found: Ensemble, labels: list[str]) -> dict[str, object]:
    return {
        "scores": {name: score.content for name, score in zip([*labels, "mean"], found.scores, strict=True)},
        "spread": dict(zip(found.names, found.spread.mean(axis=0).tolist(), strict=True)),
        "covered": dict(zip(found.names, found.covered.tolist(), strict=True)),
    }


def _table(found: dict[str, Ensemble], labels: list[str]) -> Table:
    table = Table("record", "output", *labels, "mean", f"within {DEVIATIONS:g} deviations", title="free run R2")
    for record, item in found.items():
        for k, name in enumerate(item.names):
            scores = [(score.outputs.get(name) or score).r2 for score in item.scores]
            table.add_row(record, name, *(f"{value:.4f}" for value in scores), f"{item.covered[k]:.0%}")
    return table
