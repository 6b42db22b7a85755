"""hybrid-sysid import: records of other programs become bags of a rig."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.options import Overwrite, RigName
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.importing.commands.options import ColumnNames, ColumnUnits, OtherFiles, pairs
from hybrid_sysid_ros.extensions.importing.conversion import check_fits, records_of, write_records
from hybrid_sysid_ros.extensions.importing.guessing import Question, guessed
from hybrid_sysid_ros.extensions.importing.log_file import LogFile
from hybrid_sysid_ros.extensions.importing.mapping import FILE, ImportMapping
from hybrid_sysid_ros.extensions.importing.readers import open_joined
from hybrid_sysid_ros.rigs import folder
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError, counted
from hybrid_sysid_ros.support.files import check_file, check_folder


def command(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Records: csv, mat, npz, parquet, mf4, tdms, ulg, bags of ROS."),
    ],
    rig: RigName = "",
    out: Annotated[Path, typer.Option("--out", help="Folder for the bags, which are called as their files.")] = Path(
        "bags"
    ),
    also: OtherFiles = None,
    mapping: Annotated[
        Path | None,
        typer.Option(
            help="YAML with the columns of the signals; it is used if it exists, and written otherwise, or anew with "
            "--overwrite where --column, --unit or --period are given. By default "
            "import.yaml in the folder of your own rig, and in the folder of the bags for a rig of a package."
        ),
    ] = None,
    column: ColumnNames = None,
    unit: ColumnUnits = None,
    period: Annotated[
        float, typer.Option(help="Sampling time [s] of files in which no column has the times.", min=0.0)
    ] = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Turn records of other programs into bags of a rig: columns, units and times go by a small YAML, which is guessed
    the first time.
    """
    described = load_rig(rig)
    names = [file.resolve().stem for file in files]
    if twins := {name for name in names if names.count(name) > 1}:
        raise UserError(f"two files are called {min(twins)}: the bags go by the name, so rename one")
    for name in names:
        check_folder(out / name, marker=bags.markers(out / name), replace=overwrite)
    place = mapping or _usual_place(described, out)
    given, units = pairs(column, "--column"), pairs(unit, "--unit")
    if also and len(files) > 1:
        raise UserError("--also joins files with one other; import one record at a time")
    log_files = [open_joined(file, also or ()) for file in files]
    known = place.exists() and not (given or units or period)
    if known:
        chosen = ImportMapping.load(place)
    else:
        check_file(place, replace=overwrite)
        chosen = guessed(log_files[0], described, given=given, units=units, period=period, ask=_asked)
    where = place if known else log_files[0].path
    for file in log_files:
        check_fits(file, chosen, described, where=where, stated="time" in units)
    found = list[tuple[LogFile, list[Record]]]()
    for file in log_files:
        records, notes = records_of(file, chosen, described)
        found.append((file, records))
        for line in notes:
            status.print(f"note: {line}")
    if known:
        status.print(f"columns as {place} says")
    else:
        chosen.save(place, f"Columns of log files as signals of the rig {described.name}.")
    for file, records in found:
        made_by = typed()
        for bag in write_records(records, described, out, made_by=made_by, replace_old=overwrite):
            console.print(f"{bag}: from {file.path}")
    print_table(_table(chosen, described, [record for _, records in found for record in records]))
    if not known:
        console.print(f"{place}: the columns, which the next import takes; correct it where it is wrong")


def _usual_place(rig: Rig, out: Path) -> Path:
    return out / FILE if rig.name in folder.names() else rig.folder / FILE


def _asked(question: Question) -> str:
    """The user's answer at a terminal; elsewhere none."""
    if not (sys.stdin.isatty() and question.candidates):
        return ""
    for number, name in enumerate(question.candidates, 1):
        status.print(f"  {number}: {name}")
    answer = typer.prompt(f"which number is {question.signal}", type=int, err=True)
    return question.candidates[answer - 1] if 1 <= answer <= len(question.candidates) else ""


def _table(mapping: ImportMapping, rig: Rig, records: list[Record]) -> Table:
    """Signals with their columns, units and the ranges that they have in the records."""
    table = Table(
        "signal", "column", "unit there", "lowest", "highest", "unit", title=f"{rig.name}: {_lengths(records)}"
    )
    if mapping.time.column:
        longest = max(record.duration for record in records)
        table.add_row("time", mapping.time.column, mapping.time.unit, "0", f"{longest:.4g}", "s")
    for kind, items in (("input", rig.system.inputs), ("output", rig.system.outputs)):
        for index, item in enumerate(items):
            values = [getattr(record, kind)[:, index] for record in records]
            column = {**mapping.inputs, **mapping.outputs}[item.name]
            table.add_row(
                item.name, column.column, column.unit or f"not stated, taken as {item.unit or '1'}",
                f"{min(value.min() for value in values):.4g}", f"{max(value.max() for value in values):.4g}", item.unit,
            )  # fmt: skip
    return table


def _lengths(records: list[Record]) -> str:
    seconds, samples = sum(record.duration for record in records), sum(record.samples for record in records)
    count = counted(len(records), "record")
    return f"{count}, {samples} samples, {seconds:.6g} s, one in {records[0].sampling_time:.6g} s"
