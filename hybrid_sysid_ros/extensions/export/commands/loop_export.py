"""hybrid-sysid export loop: a loop without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import Overwrite, console
from hybrid_sysid_ros.extensions.export.unit.folder import MANIFEST, TOLERANCE, export_loop
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="Folder for the C unit.")],
    rig: Annotated[str, typer.Option("--rig", help="Folder of the model's rig, if it is not known by name.")] = "",
    real_time: Annotated[
        bool, typer.Option("--real-time/--converged", help="One iteration in a period, or as many as it takes.")
    ] = True,
    daqp: Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's loop, estimator and exact MPC, as C99 without allocation, if it answers as in Python."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    loaded = load_model(model, rig=rig)
    done = export_loop(
        load_rig(rig or loaded.rig),
        loaded,
        out,
        settings={"real_time": real_time},
        seal=storage.digest(model, kind="model"),
        source=daqp,
        overwrite=overwrite,
    )
    for kind, parts in done.differences.items():
        console.print(
            f"{out / done.name}.c: {done.periods[kind]} {kind} periods as in Python, inputs to {parts['inputs']:.1e} "
            f"(tolerance {TOLERANCE:g}; {done.by})"
        )
    console.print(f"{out / done.name}.h: its memory has {done.bytes} bytes; README.md says how it is called")
