"""The command that turns the author's records into bags."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import console, status
from studies.beam_lecture.records import import_folder


def command(
    folder: Annotated[Path, typer.Argument(help="Folder with the author's .mat files.")],
    out: Annotated[Path, typer.Argument(help="Folder for the bags.")],
) -> None:
    """Turn the author's records of the cam-driven beam into bags, at their full rate."""
    for path in import_folder(folder, out, progress=status.print):
        console.print(str(path))
