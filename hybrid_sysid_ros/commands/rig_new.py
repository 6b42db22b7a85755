"""hybrid-sysid rig new: a small rig to begin with."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.rigs.folder import HOME, SYSTEM, VALUES, check_name
from hybrid_sysid_ros.support.errors import UserError

TEMPLATE = HOME / "_template"


def command(folder: Annotated[Path, typer.Argument(help="Folder to make; its name is the rig's.")]) -> None:
    """Write a small working rig, a sled on a rail, to be made your own."""
    check_name(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"{folder}: is there already and not empty; give the name of a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in (SYSTEM, VALUES):
            shutil.copyfile(TEMPLATE / file, folder / file)
    except OSError as error:
        raise UserError(f"{folder}: can't be written ({error.strerror}); give another folder") from error
    console.print(f"{folder}: {SYSTEM} and {VALUES}; next: hybrid-sysid rig check {_path(folder)}")


def _path(folder: Path) -> str:
    """The folder in a form that is taken for a path."""
    text = str(folder)
    return text if "/" in text or text.startswith(".") else f"./{text}"
