"""hybrid-sysid check-record: records against themselves and their rig."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.records import check_names
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding, sentence
from hybrid_sysid_ros.extensions.record_check.report.record_page import write_record_page
from hybrid_sysid_ros.extensions.shared import report as reports
from hybrid_sysid_ros.library.records import checked_bag
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.extensions import provided
from hybrid_sysid_ros.support.files import check_file


def command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to check.")],
    rig: options.RigName = "",
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    report: Annotated[Path | None, typer.Option(help="Write an HTML page with plots.")] = None,
    as_json: options.Json = False,
) -> None:
    """Check records before a model is fitted to them: faults with their cures, the costliest first. The exit status is
    1 where a fit would be worth nothing.
    """
    if report is not None:
        reports.check_available()
        check_file(report, suffix=".html")
    check_names(bag)
    described = load_rig(rig)
    found, records = dict[str, list[RecordFinding]](), list[Record]()
    for path in bag:
        record = checked_bag(
            path, described, signals=signals, period=read_period, recover=recover, doubtful=lambda line: None
        )
        records.append(record)
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
    for remarks in () if as_json else provided("record_remarks").values():
        for line in remarks(records, described):
            console.print(line)
    if report is not None:
        by_name = dict(zip([record.name for record in records], found.values(), strict=True))
        hashes = {f"bag {one.name}": one.digest for one in records}
        provenance = reports.Provenance(command=typed(), hashes=hashes, versions=versions())
        write_record_page(report, described, records, by_name, provenance)
        status.print(str(report))
    if any(item.blocks for findings in found.values() for item in findings):
        raise typer.Exit(1)
