"""hybrid-sysid parameters: the parameter file of a rig's nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, RigName
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.parameters import parameter_file
from hybrid_sysid_ros.support.files import check_file, write_text


def command(
    rig: RigName = "",
    out: Annotated[Path | None, typer.Option(help="File to write; without it the parameters are printed.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a ROS parameter file with every parameter of every node of a rig, for `--params-file`."""
    if out is not None:
        check_file(out, replace=overwrite)
    text = parameter_file(rig or rigs.default())
    if out is None:
        print(text, end="")
        return
    write_text(out, text)
    console.print(str(out))
