"""hybrid-sysid rig layouts: a rig for other people's tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, RigPlace
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.view import layouts
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.files import check_file, write_text


def command(
    rig: RigPlace,
    folder: Annotated[Path, typer.Argument(help="Folder of the files.")] = Path(),
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's URDF, and layouts for Foxglove (or Lichtblick) and PlotJuggler."""
    described = load(rig)
    contents = {
        f"{described.name}.urdf": Drawing(described).urdf(),
        f"{described.name}.foxglove.json": layouts.foxglove(described),
        f"{described.name}.plotjuggler.xml": layouts.plotjuggler(described),
    }
    for name in contents:
        check_file(folder / name, replace=overwrite)
    for name, content in contents.items():
        write_text(folder / name, content)
        console.print(str(folder / name))
