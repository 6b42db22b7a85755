"""hybrid-sysid rig from: a rig for identification out of a record."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.importing.commands.options import ColumnNames, ColumnUnits, OtherFiles, pairs
from hybrid_sysid_ros.extensions.importing.generated_rig import is_stepped, made_rig, never_changes, roles
from hybrid_sysid_ros.extensions.importing.log_file import LogFile
from hybrid_sysid_ros.extensions.importing.mapping import FILE
from hybrid_sysid_ros.extensions.importing.readers import open_joined
from hybrid_sysid_ros.extensions.importing.time_columns import time_of
from hybrid_sysid_ros.rigs.folder import SYSTEM, VALUES, check_name
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder


def command(
    file: Annotated[Path, typer.Argument(help="A record of the rig.")],
    folder: Annotated[Path, typer.Argument(help="Folder to make; its name is the rig's.")],
    inputs: Annotated[
        list[str] | None,
        typer.Option("--input", metavar="COLUMN", help="Column of an input; for several, repeat it."),
    ] = None,
    outputs: Annotated[
        list[str] | None,
        typer.Option("--output", metavar="COLUMN", help="Column of an output; for several, repeat it."),
    ] = None,
    also: OtherFiles = None,
    column: ColumnNames = None,
    unit: ColumnUnits = None,
    period: Annotated[float, typer.Option(help="Sampling time [s] where no column has the times.", min=0.0)] = 0.0,
) -> None:
    """Write a rig's folder out of a record, for identification alone: signals, units, limits, the step of fits, and a
    linear equation of low order for each output, which you may replace by the physics.
    """
    check_name(folder)
    log, given, units = open_joined(file, also or ()), pairs(column, "--column"), pairs(unit, "--unit")
    inputs, outputs = ([log.column_of(text) for text in chosen or ()] for chosen in (inputs, outputs))
    given = {name: log.column_of(text) for name, text in given.items()}
    units = {log.column_of(name): unit for name, unit in units.items()}
    _check_columns(log, [*inputs, *outputs, *given.values(), *(name for name in units if name != "time")])
    if strange := [name for name in given if name != "time"]:
        raise UserError(f"--column {strange[0]}: only time=COLUMN; name the others by --input and --output")
    time, free = time_of(log, list(log.columns.values()), given, units, period)
    if isinstance(time, str):
        raise UserError(time)
    free = [item for item in free if item.name != time.column]
    chosen_in, chosen_out = roles(free, inputs, outputs, lambda name: is_stepped(log.read([name])[name]))
    guessed = [name for name in (*chosen_in, *chosen_out) if name not in (*inputs, *outputs)]
    constant = [name for name, values in log.read(guessed).items() if never_changes(values)]
    chosen_in, chosen_out = ([name for name in chosen if name not in constant] for chosen in (chosen_in, chosen_out))
    for kind, chosen in (("input", chosen_in), ("output", chosen_out)):
        if not chosen:
            raise UserError(
                f"{file}: which columns are {kind}s? name each: --{kind} COLUMN; the columns are "
                f"{', '.join(list(log.columns)[:30])}"
            )
    if both := {*chosen_in} & {*chosen_out}:
        raise UserError(f"{file}: {min(both)} is an input and an output; take one of them away")
    made = made_rig(folder.resolve().name, log, time, chosen_in, chosen_out, units)
    with written_folder(folder, marker=VALUES, replace=False) as partial:
        (partial / SYSTEM).write_text(made.system, encoding="utf-8")
        (partial / VALUES).write_text(made.values, encoding="utf-8")
        made.mapping.save(partial / FILE, f"Columns of log files as signals of the rig {folder.resolve().name}.")
    place = (
        folder if folder.is_absolute() or str(folder).startswith((".", "~")) or "/" in str(folder) else f"./{folder}"
    )
    console.print(f"inputs: {', '.join(chosen_in)}; outputs: {', '.join(chosen_out)}; fits in steps of {made.step:g} s")
    if constant:
        console.print(f"left out: {', '.join(constant[:30])}, which never changes")
    left = [item.name for item in free if item.name not in (*chosen_in, *chosen_out, *constant)]
    if left and not (inputs and outputs):
        console.print(f"left out: {', '.join(left[:30])}, whose names don't say what they are (--input, --output)")
    for name, mapped in made.mapping.signals.items():
        if mapped.unwrap:
            console.print(f"{name} comes modulo a turn [{mapped.unit}], and is made whole (unwrap in {FILE})")
        if mapped.missing is not None:
            console.print(f"{name}: {mapped.missing:g} stands for missing values, a guess (missing in {FILE})")
    for name in made.turning:
        console.print(
            f"{name} goes beyond half a turn, which a linear equation says nothing of: if it is a pendulum, put "
            f"its sine into {SYSTEM}, or identify with --structure state_space"
        )
    for name, seconds in made.delays.items():
        console.print(f"{name} acts {seconds:.3g} s later, which {name}_delay of {SYSTEM} begins at and fits correct")
    console.print(f"{place}: {SYSTEM}, {VALUES} and {FILE}")
    console.print(f"next: hybrid-sysid rig check {shlex.quote(str(place))}")
    others = [part for item in also or () for part in ("--also", str(item))]
    arguments = shlex.join(["import", str(file), *others, "--rig", str(place), "--out", "bags"])
    console.print(f"      hybrid-sysid {arguments}")


def _check_columns(log: LogFile, names: list[str]) -> None:
    if unknown := [name for name in names if name not in log.columns]:
        raise UserError(f"{log.path}: no column {unknown[0]!r}; it has {', '.join(list(log.columns)[:30])}")
