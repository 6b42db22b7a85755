"""hybrid-sysid rig driver: a driver for a rig's hardware, to begin with."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

TEMPLATE = Path(__file__).parents[1] / "template"
FILES = ("driver.py", "board.py", "test_driver.py")


def command(folder: Annotated[Path, typer.Argument(help="Folder of the rig.")]) -> None:
    """Write a driver node, a simulated board and a test of both into a rig's folder, to be made your own."""
    load(f"./{folder}" if len(folder.parts) == 1 else folder)
    present = [file for file in FILES if (folder / file).exists()]
    if present:
        raise UserError(f"{folder / present[0]}: is there already; rename or remove it")
    try:
        for file in FILES:
            shutil.copyfile(TEMPLATE / file, folder / file)
    except OSError as error:
        raise UserError(f"{folder}: can't be written ({error.strerror}); change its permissions") from error
    console.print(f"{folder}: {', '.join(FILES)}; next: python -m pytest {folder}")
