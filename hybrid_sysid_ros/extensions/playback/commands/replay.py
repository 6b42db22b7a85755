"""hybrid-sysid replay: a recorded loop's estimator and controller again."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import options, terminal
from hybrid_sysid_ros.extensions.playback import replaying
from hybrid_sysid_ros.extensions.playback.comparison import SETTLED, ReplayComparison, compare
from hybrid_sysid_ros.extensions.playback.report.replay_page import write_replay
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.support.files import check_file, check_folder, make_folder, sha256, write_text

BAG, NUMBERS, PAGE = "replayed", "replay.json", "report.html"


def command(
    bag: Annotated[Path, typer.Argument(help="Bag of a recorded closed loop.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the replayed bag, the numbers and a report.")] = None,
    rig: options.RigName = "",
    model: Annotated[
        Path | None, typer.Option(help="Model folder; by default the model that the bag was recorded with.")
    ] = None,
    policy: Annotated[
        options.DriverChoice | None, typer.Option(help="What drives the rig; as recorded by default.")
    ] = None,
    policy_path: Annotated[
        Path | None, typer.Option(help="Policy folder; by default the policy that the bag was recorded with.")
    ] = None,
    recover: options.Recover = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Send what a bag recorded of a loop through estimator and controller again, and compare the answers."""
    processes.check_ros()
    changes = replaying.Changes(
        rig=rig, model=str(model or ""), policy=policy or "", policy_path=str(policy_path or "")
    )
    if out is not None:
        report.check_available()
        make_folder(out)
        check_folder(out / BAG, marker=bags.markers(out / BAG), replace=overwrite)
        for name in (NUMBERS, PAGE):
            check_file(out / name)
    with TemporaryDirectory() as scratch:
        replayed = (out or Path(scratch)) / BAG
        plan = replaying.replay(bag, replayed, changes, recover=recover, tell=terminal.status.print)
        comparison = compare(bag, replayed, plan.rig, recover=recover)
    kind = (
        "recorded in lockstep"
        if plan.lockstep
        else "recorded in real time, so that references and ages differ a little"
    )
    summary = f"{bags.name_of(bag)}, {kind}; parameters: {plan.source}; {replaying.change_summary(plan.changes)}."
    content = {"bag": str(bag), "lockstep": plan.lockstep, "parameters": plan.source, **comparison.content}
    if as_json:
        terminal.console.print(json.dumps(content, indent=2))
    else:
        terminal.console.print(summary)
        for table in tables(comparison):
            terminal.print_table(table)
    if out is not None:
        write_text(out / NUMBERS, json.dumps(content, indent=2) + "\n")
        provenance = report.Provenance(
            command=terminal.typed(),
            hashes={f"bag, {bags.name_of(bag)}": sha256(bag), f"bag, {BAG}": sha256(out / BAG)},
            versions=versions(),
        )
        title = f"{plan.rig.name}: replay of {bags.name_of(bag)}"
        write_replay(out / PAGE, comparison, title, summary, provenance)
        (terminal.status if as_json else terminal.console).print(
            f"report: {out / PAGE}   numbers: {out / NUMBERS}   bag: {out / BAG}"
        )


def tables(comparison: ReplayComparison) -> list[Table]:
    """Differences, a table for each topic."""
    found = []
    for topic, common in comparison.common.items():
        counts = f"{comparison.recorded[topic]} recorded, {comparison.replayed[topic]} replayed, {common} in common"
        table = Table("number", "unit", title=f"{topic}: {counts}")
        for heading in ("largest difference", f"after {SETTLED:g} s", "rms"):
            table.add_column(heading, justify="right")
        for number in comparison.of(topic):
            values = (number.largest, number.settled, number.rms)
            table.add_row(number.field, number.unit, *(f"{value:.3g}" for value in values))
        found.append(table)
    return found
