"""hybrid-sysid export ros2_control: a colcon package with a controller around a loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import Overwrite, OwnRig, console
from hybrid_sysid_ros.extensions.export.ros2_control.export import MARKER, export_ros2_control
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="Folder for the package.")],
    rig: OwnRig = "",
    policy: Annotated[Path | None, typer.Option(help="Policy folder: it drives while it passes the check.")] = None,
    daqp: Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a colcon package with a chainable controller of ros2_control around a rig's estimator and controller."""
    check_folder(out, marker=MARKER, replace=overwrite)
    loaded = load_model(model, rig=rig)
    driver = {} if policy is None else {"policy": "supervised", "policy_path": str(policy)}
    seals = {} if policy is None else {"policy_seal": storage.digest(policy, kind="policy")}
    done = export_ros2_control(
        load_rig(rig or loaded.rig),
        loaded,
        out,
        settings={"real_time": True, **driver},
        seal=storage.digest(model, kind="model"),
        source=daqp,
        overwrite=overwrite,
        **seals,
    )
    worst = max(done.differences["recorded"].values())
    console.print(
        f"{out}: package {done.name}_controller; its unit answers {done.periods['recorded']} recorded periods as in "
        f"Python, to {worst:.1e}"
    )
    console.print(
        "the plugin was NOT built here, and never linked against ros2_control: README.md says how to build it"
    )
