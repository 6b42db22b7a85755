"""hybrid-sysid export mjcf: a MuJoCo model with the identified joints of a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.commands.urdf_export import write


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="File to write, NAME.xml.")],
    rig: OwnRig = "",
    overwrite: Overwrite = False,
) -> None:
    """Write a MuJoCo model with the identified joints of a rig, compared with a free run where MuJoCo is installed."""
    done = write("mjcf", model, out, rig=rig, overwrite=overwrite)
    if done.difference is None:
        console.print(f"{out}: NOT COMPARED, for MuJoCo is missing: pip install 'hybrid_sysid_ros[mujoco]'")
    else:
        console.print(f"{out}: a free run in MuJoCo differs by {done.difference:.1%} (r.m.s. of the velocities)")
