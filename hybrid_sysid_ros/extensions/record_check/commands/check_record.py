"""hybrid-sysid check-record: records against themselves and their rig."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.library.records import checked_bag
from hybrid_sysid_ros.rigs.rig import load as load_rig


def command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to check.")],
    rig: terminal.RigName = "",
    signals: terminal.SignalsFile = None,
    recover: terminal.Recover = False,
    read_period: terminal.ReadPeriod = 0.0,
    as_json: terminal.Json = False,
) -> None:
    """Check records before a model is fitted to them: faults with their cures, the costliest first. The exit status is
    1 where a fit would be worth nothing.
    """
    described = load_rig(rig)
    found = dict[str, list[RecordFinding]]()
    for path in bag:
        record = checked_bag(
            path, described, signals=signals, period=read_period, recover=recover, doubtful=lambda line: None
        )
        found[str(path)] = findings_of(record, described)
    if as_json:
        rows = {
            name: [{"kind": f.kind, "cost": f.cost, "words": f.words, "cure": f.cure} for f in findings]
            for name, findings in found.items()
        }
        console.print_json(json.dumps(rows))
    for name, findings in () if as_json else found.items():
        console.print(f"{bags.name_of(name)}: {sentence(findings)}")
        if findings:
            table = Table("what", "cost", "seen", "cure")
            for item in findings:
                table.add_row(item.kind, f"{item.cost:.2f}", item.words, item.cure)
            print_table(table)
    if any(item.blocks for findings in found.values() for item in findings):
        raise typer.Exit(1)


def sentence(findings: list[RecordFinding]) -> str:
    """What to make of a record, in a sentence."""
    if not findings:
        return "no fault is seen; go on to identify"
    worst, more = findings[0], len(findings) - 1
    others = f", and {more} more" if more else ""
    if worst.blocks:
        return f"a fit would be worth nothing before this is cured: {worst.kind}{others}"
    return f"usable with care: {worst.kind}{others}"
