"""hybrid-sysid export urdf: identified friction and inertia in a rig's URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.robots.export import SUFFIXES, RobotExport, export_robot
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_file


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="File to write, NAME.urdf.")],
    rig: OwnRig = "",
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's URDF with the identified damping, friction and inertia of its joints."""
    write("urdf", model, out, rig=rig, overwrite=overwrite)


def write(form: str, model: Path, out: Path, *, rig: str, overwrite: bool) -> RobotExport:
    """Write a file, and say what is in it and what is not."""
    check_file(out, suffix=SUFFIXES[form], replace=overwrite)
    loaded = load_model(model, rig=rig)
    own, seal = load_rig(rig or loaded.rig), storage.digest(model, kind="model")
    done = export_robot(own, loaded, out, form=form, seal=seal, overwrite=overwrite)
    for joint in done.joints:
        unit = "" if joint.identified else " per unit inertia"
        console.print(
            f"{out}: joint {joint.name}: inertia {joint.inertia:.4g}, damping {joint.damping:.4g}, friction "
            f"{joint.friction:.4g}{unit}"
        )
    for remark in done.remarks[1:]:
        console.print(f"not in it: {remark}")
    return done
