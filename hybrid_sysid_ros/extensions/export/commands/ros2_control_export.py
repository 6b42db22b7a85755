"""hybrid-sysid export ros2_control: a colcon package with a controller around a loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.exported_loop import Daqp, PolicyFolder, exported_loop
from hybrid_sysid_ros.extensions.export.ros2_control.export import MARKER, export_ros2_control
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="Folder for the package.")],
    rig: OwnRig = "",
    policy: PolicyFolder = None,
    daqp: Daqp = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a colcon package with a chainable controller of ros2_control around a rig's estimator and controller."""
    check_folder(out, marker=MARKER, replace=overwrite)
    described, loaded, given = exported_loop(model, rig, policy, daqp)
    done = export_ros2_control(described, loaded, out, **given, overwrite=overwrite)
    worst = max(done.differences["recorded"].values())
    console.print(
        f"{out}: package {done.name}_controller; its unit answers {done.periods['recorded']} recorded periods as in "
        f"Python, to {worst:.1e}"
    )
    console.print(
        "the plugin was NOT built here, and never linked against ros2_control: README.md says how to build it"
    )
