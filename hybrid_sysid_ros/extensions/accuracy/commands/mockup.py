"""hybrid-sysid mockup: a rig's performance digital mock-up, from what is known beforehand to a verdict."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import ClusterAddress, Json, RigPlace, Seed
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.accuracy.mockup import ShotPlan, mockup
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns, Range, batches
from hybrid_sysid_ros.extensions.accuracy.report.accuracy_page import accuracy_rows
from hybrid_sysid_ros.extensions.accuracy.report.mockup_page import parameter_rows, write_mockup
from hybrid_sysid_ros.extensions.accuracy.setup import Setup
from hybrid_sysid_ros.extensions.accuracy.statistics import Discrepancy
from hybrid_sysid_ros.extensions.accuracy.verdict import Found
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.shared.parallel import Store, resumed, workers_for
from hybrid_sysid_ros.extensions.shared.workers import Lost
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.arrays import NamedArrays
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.files import check_file, make_folder, write_text
from hybrid_sysid_ros.support.progress import progress_bars

WORDS = {True: "yes", False: "NO", None: "open"}
BATCH = 5
"""Shots that a process fires at a time."""
PAGE, NUMBERS, SHOTS = "verdict.html", "verdict.json", "shots"


def command(
    rig: RigPlace = "",
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the results; out/mockup_RIG by default.")
    ] = None,
    live: Annotated[int, typer.Option(help="Number of shots of the rig.", min=3, max=10_000)] = 10,
    simulated: Annotated[
        int, typer.Option(help="Number of simulated shots of the model, and of the prior.", min=50)
    ] = 100,
    plants: Annotated[int, typer.Option(help="Number of plants drawn from the uncertainties.", min=10)] = 200,
    mean_off: Annotated[
        float, typer.Option(help="Declared: the simulated mean is off by so many standard deviations (one sigma).")
    ] = 0.5,
    spread_off: Annotated[
        float, typer.Option(help="Declared: the simulated spread is off by a factor of e to this (one sigma).")
    ] = 0.3,
    matters: Annotated[
        float,
        typer.Option(
            help="Share of an error, a settling time or a path that a difference needs to matter.", min=0.001, max=10.0
        ),
    ] = 0.1,
    fleet: Annotated[
        bool, typer.Option("--fleet", help="Fire each shot with another plant of a series, in place of one vehicle.")
    ] = False,
    model: Annotated[
        Path | None, typer.Option(help="Model of the real rig, in place of experiments and identification.")
    ] = None,
    live_bags: Annotated[
        list[Path] | None,
        typer.Option("--live-bags", help="Bag of a loop of the real rig, in place of a live shot; several times."),
    ] = None,
    seed: Seed = 0,
    jobs: Annotated[int, typer.Option(help="Number of processes; 0: one on each processor.", min=0)] = 0,
    cluster: ClusterAddress = "",
    as_json: Json = False,
) -> None:
    """Go through a rig's performance digital mock-up: simulate what is known beforehand, drive experiments, identify a
    gray box and the rig's structure, fire shots of the model and of the rig and compare them, close the loop on
    uncertain plants, and write a page with the verdict.

    Ctrl-C keeps what is done; the same command goes on from there.
    """
    described = load_rig(rig or default())
    setup = Setup.of(described, seed)
    if live_bags and model is None:
        raise UserError(
            "--live-bags are loops of the real rig: give the model that its records taught by --model FOLDER"
        )
    shooting = ShotPlan(
        live=live,
        simulated=simulated,
        plants=plants,
        discrepancy=Discrepancy(mean=mean_off, spread=spread_off),
        matters=matters,
        fleet=fleet,
        recorded=[LoopRecord.from_bag(bag, described) for bag in live_bags or []],
        model=None if model is None else load_model(model, rig=described.source),
    )
    place = out or Path("out") / f"mockup_{described.name}"
    _prepare(place)
    crew = Crew(folder=place / SHOTS, jobs=jobs, cluster=cluster)
    try:
        found = mockup(setup, place, crew.fire, shooting, status.print if as_json else console.print)
    except KeyboardInterrupt:
        raise Interrupted(f"what is done is in {place}; the same command goes on from there") from None
    content = _write(place, found)
    if as_json:
        console.print(content)
        return
    print_table(_table(found))
    console.print(f"report: {place / PAGE}   numbers: {place / NUMBERS}")


def _prepare(place: Path) -> None:
    """Make the folders of the results. Raises UserError where they could not be written."""
    report.check_available()
    for folder in (place, place / SHOTS):
        make_folder(folder)
    for name in (PAGE, NUMBERS):
        check_file(place / name)


def _write(place: Path, found: Found) -> str:
    """Write the page and the numbers, and return these as JSON."""
    content = json.dumps(_content(found), indent=2)
    write_text(place / NUMBERS, content + "\n")
    write_mockup(place / PAGE, found, report.provenance(found.model, typed()))
    return content


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Processes or a cluster that fire shots, and where these are kept."""

    folder: Path
    jobs: int
    cluster: str

    def fire(self, where: Range, count: int, name: str) -> MonteCarloRuns:
        """So many shots. Raises UserError where processes are lost again and again."""
        store: Store[NamedArrays] = Store(self.folder, json.dumps(where.content(), sort_keys=True, default=repr))
        items, found = list(batches(count, BATCH)), {}
        crew = workers_for(where, jobs=self.jobs, cluster=self.cluster, tell=status.print)
        with crew as workers, progress_bars(status) as update:
            for numbers_of, result, _ in resumed(workers, items, store=store, finish=True):
                if isinstance(result, Lost):
                    raise UserError(f"{name}: {result.reason}")
                found[numbers_of] = result
                update(name, min(BATCH * len(found), count), count)
        rows = {key: np.concatenate([found[item][key] for item in items]) for key in found[items[0]]}
        return MonteCarloRuns(where=where, rows=rows)


def _content(found: Found) -> dict[str, Any]:
    """Everything as plain data."""
    return {
        "rig": found.setup.rig.name,
        "structure": found.model.structure,
        "kept": found.fit,
        "conclusion": found.conclusion,
        "fleet": found.runs["live"].where.fleet,
        "verdict": [{"criterion": line.name, "kept": line.kept, "words": line.words} for line in found.verdict],
        "compared": {
            "prior" if name == "prior" else "model": {
                of: [
                    {
                        "quantity": item.name,
                        "unit": item.unit,
                        "verdict": item.verdict.value,
                        "simulated": item.simulated,
                        "live": item.live,
                        "difference": item.difference,
                        "at_most": item.bound,
                        "noticed": item.noticed,
                        "share_of": item.size,
                        "p": item.probability,
                    }
                    for item in items
                ]
                for of, items in compared.items()
            }
            for name, compared in found.compared.items()
        },
        "parameters": list(parameter_rows(found)),
        "errors": {"of": found.ahead, **found.errors},
        "shots": {
            name: {
                "count": len(runs.tracking_error),
                "held": int(runs.sound.all(axis=1).sum()),
                **{
                    window: {
                        "unit": unit,
                        "mean": float(runs.tracking_error[:, k].mean()),
                        "deviation": float(runs.tracking_error[:, k].std(ddof=1)),
                        "rmse": float(runs.rmse[:, k].mean()),
                    }
                    for k, (window, unit) in enumerate(runs.windows.items())
                },
            }
            for name, runs in found.runs.items()
        },
        "accuracy": [
            {"of": row.name, "live": row.live.value, "together": row.together.value, "narrower_percent": row.narrower}
            for row in accuracy_rows(found.accuracy)
        ],
    }


def _table(found: Found) -> Table:
    table = Table("", "kept", "", title=f"{found.setup.rig.name}: {found.conclusion}")
    for line in found.verdict:
        table.add_row(line.name, WORDS[line.kept], line.words)
    return table
