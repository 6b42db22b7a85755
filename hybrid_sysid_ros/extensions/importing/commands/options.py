"""Options that both commands have: columns and units by the names of signals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.support.errors import UserError

ColumnNames = Annotated[
    list[str] | None,
    typer.Option(
        "--column", metavar="SIGNAL=COLUMN", help="Column of a signal, or of time=COLUMN, instead of a guess."
    ),
]
ColumnUnits = Annotated[
    list[str] | None,
    typer.Option("--unit", metavar="SIGNAL=UNIT", help="Unit of a signal's column, as angle=deg."),
]
OtherFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--also",
        metavar="FILE",
        help="Another file of the same record, such as of a second device; columns are then named FILE.COLUMN.",
    ),
]


def pairs(given: Sequence[str] | None, option: str) -> dict[str, str]:
    """Values by name. Raises UserError for a text without "="."""
    found = dict[str, str]()
    for text in given or ():
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise UserError(f"{option} {text}: write it as SIGNAL=VALUE, such as {option} position=x")
        found[name] = value
    return found
