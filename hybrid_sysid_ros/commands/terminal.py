"""Common parts of all commands: their output and their options."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, Literal, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from hybrid_sysid_ros.models import InputHandling, Sampling, structure_names
from hybrid_sysid_ros.rigs import folder
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig

PLAIN: dict[str, Any] = {"markup": False, "emoji": False}
"""Options that print names unchanged: a record may be called run[red] or a:b:c."""


def reader_gone() -> NoReturn:
    """End well, since nobody reads standard output any more, as after ``| head``; what is left is for nobody."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(0)


class PipedConsole(Console):
    """A console behind which a pipe may close."""

    def on_broken_pipe(self) -> None:
        reader_gone()


console = PipedConsole(soft_wrap=True, **PLAIN)
status = Console(stderr=True, soft_wrap=True, **PLAIN)

WIDEST = 100_000
"""More columns than any table has."""

RigName = Annotated[
    str,
    typer.Option(
        "--rig", help="Rig, by its name or by the path of its folder (./my_rig).", autocompletion=folder.names
    ),
]
RigPlace = Annotated[
    str, typer.Argument(help="Rig, by its name or by the path of its folder.", autocompletion=folder.names)
]
ModelFolder = Annotated[Path, typer.Argument(help="Model folder.")]


def _meet(rig: str) -> str:
    """Load a rig by its path, so that it is then known by the name in models and policies."""
    if rig:
        load_rig(rig)
    return rig


OwnRig = Annotated[str, typer.Option("--rig", help="Folder of the rig, if it is not known by name.", callback=_meet)]
"""Option of commands that get their rig from a model or a policy."""
SignalsFile = Annotated[Path | None, typer.Option("--signals", help="YAML with the topics and fields of your own bag.")]
Recover = Annotated[bool, typer.Option("--recover", help="Read what can be read of a truncated bag.")]
ReadPeriod = Annotated[
    float,
    typer.Option(
        "--read-period",
        help="Keep one sample in so many seconds, with the mean input between them, of a bag that is larger than the "
        "memory; 0 keeps all.",
        min=0.0,
    ),
]
PartText = Annotated[str, typer.Option("--part", help="Part of each bag that is used, as fractions START:STOP.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
DriverChoice = Literal["supervised", "network", "exact"]
"""Choices of the controller's parameter policy."""
WorkerCount = Annotated[int, typer.Option("--workers", help="Number of processes; 0: one on each processor.", min=0)]
ClusterAddress = Annotated[
    str,
    typer.Option("--cluster", help="Address of a Dask scheduler, such as tcp://host:8786; local starts one."),
]
Seed = Annotated[int, typer.Option("--seed", help="Random seed.", min=0)]
InputHandlingOption = Annotated[
    InputHandling,
    typer.Option(
        "--input",
        help="How the model takes its input: the mean over each step of samples that are held (averaged) or joined by "
        "lines (interpolated), one reading a period (sampled), or as the training records show it (auto).",
    ),
]
Initial = Annotated[
    str | None,
    typer.Option(
        "--initial",
        metavar="estimated|first|rest|NAME=VALUE,...",
        help="State at which a simulation of a record begins: estimated from the first samples near what the record "
        "shows (the default), as the record shows it, at rest, or values of states in SI.",
    ),
]
InitialSamples = Annotated[
    int | None, typer.Option("--initial-samples", help="Scored samples that estimate a start; 40 by default.", min=1)
]
WarmUp = Annotated[
    int | None, typer.Option("--warm-up", help="First scored samples of a record that no score counts.", min=0)
]
StepOption = Annotated[
    float | None, typer.Option("--step", help="Integration step [s]; by default that of the rig's file, or 0.005.")
]
Period = Annotated[
    float | None,
    typer.Option("--period", help="Time between fitted samples [s]; by default that of the rig's file, or 0.05."),
]


def sampling_of(
    rig: Rig, step: float | None, period: float | None, handling: InputHandling, **start: str | int | None
) -> Sampling:
    """The sampling of options, the rest as the rig's file says; start: ``initial``, ``initial_samples``, ``warm_up``.
    Raises UserError for values that can't be.
    """
    from hybrid_sysid_ros.library.arguments import given_sampling  # whose SciPy would double the start of `call stop`

    given = {"step": step, "period": period, "input": handling, **start}
    return given_sampling({name: value for name, value in given.items() if value is not None}, rig)


def print_table(table: Table) -> None:
    """Print a table below its title, its cells folded to the width of a terminal; elsewhere at its own width."""
    shown = PipedConsole(width=None if console.is_terminal else WIDEST, **PLAIN)
    for column in table.columns:
        column.overflow = "fold"  # nothing is cut
    if table.title:
        shown.print(table.title, style="table.title")
        table.title = None
    shown.print(table)


def print_lines(lines: Mapping[str, str], alarms: Collection[str] = ()) -> None:
    """Print sentences behind what they are about, alarms in red."""
    indent = " " * (max(map(len, lines)) + 2)
    room = console.width if console.is_terminal else WIDEST
    for name, words in lines.items():
        begin = name.ljust(len(indent))
        text = fill(words, room, initial_indent=begin, subsequent_indent=indent, break_long_words=False)
        console.print(text, style="bold red" if name in alarms else None)


def typed() -> str:
    """The command of this process as it was typed: ``hybrid-sysid`` or ``python -m MODULE`` with its arguments."""
    given = sys.argv[1:]
    before = sys.orig_argv[: len(sys.orig_argv) - len(given)]
    module = before[before.index("-m") :] if "-m" in before else []
    return shlex.join([Path((before if module else sys.argv)[0]).name, *module, *given])


def end(problems: Sequence[str]) -> None:
    """Print problems, a line each, and end the command with status 2 if there are any."""
    for problem in problems:
        status.print(f"error: {' '.join(problem.split())}")
    if problems:
        raise typer.Exit(2)


StructureName = Annotated[
    str,
    typer.Option(
        help=f"{', '.join(structure_names())}, a further gray box of the rig, or hybrid_NAME on one.",
        autocompletion=structure_names,
    ),
]
StructureOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", metavar="NAME=VALUE", help="Option of the structure, such as units=8; may be given several times."
    ),
]


def score_table(
    scores: Mapping[str, Mapping[str, Any]],
    rig: Rig,
    title: str,
    loops: Mapping[str, Mapping[str, Any]] | None = None,
) -> Table:
    """Table of records' scores, a row for each output with errors in its display unit, beside scores of re-simulated
    loops.
    """
    names = [item.name for item in rig.system.outputs]
    several = len(names) > 1
    error = "RMSE" if several else f"RMSE [{rig.display[0].unit}]"
    table = Table("record", *(["output"] if several else []), "R2", error, "fit [%]", title=title)
    for heading in ("closed loop R2", error) if loops else ():
        table.add_column(heading)
    for record, values in scores.items():
        for index, name in enumerate(names):
            own, shown = values.get("outputs", {}).get(name, values), rig.display[index]
            rmse = f"{float(shown.shown(own['rmse'])):.4g}{f' {shown.unit}' if several else ''}"
            cells = [record, *([name] if several else []), f"{own['r2']:.4f}", rmse, f"{own['fit_percent']:.1f}"]
            if loops:
                loop = loops[record].get("outputs", {}).get(name, loops[record]) if record in loops else None
                cells += [f"{loop['r2']:.4f}", f"{float(shown.shown(loop['rmse'])):.4g}"] if loop else ["", ""]
            table.add_row(*cells)
    return table
