"""The terminal: what commands print, and where."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table

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
