"""hybrid-sysid export loop: a loop without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.exported_loop import Daqp, PolicyFolder, exported_loop
from hybrid_sysid_ros.extensions.export.unit.folder import MANIFEST, MOST, export_loop
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="Folder for the C unit.")],
    rig: OwnRig = "",
    real_time: Annotated[
        bool, typer.Option("--real-time/--converged", help="One iteration in a period, or as many as it takes.")
    ] = True,
    policy: PolicyFolder = None,
    single: Annotated[bool, typer.Option("--single", help="Floats in place of doubles.")] = False,
    daqp: Daqp = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's loop, its estimator and controller, as C99 without allocation, if it answers as in Python."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    described, loaded, given = exported_loop(model, rig, policy, daqp, real_time=real_time)
    done = export_loop(described, loaded, out, **given, single=single, overwrite=overwrite)
    for kind, parts in done.differences.items():
        most = f" in {MOST:.0%} of them" if kind == "odd" else ""
        console.print(
            f"{out / done.name}.c: {done.periods[kind]} {kind} periods as in Python, "
            f"inputs{most} to {parts['inputs']:.1e} "
            f"(tolerance {done.tolerances[kind]:g}; {done.by})"
        )
    stack = "" if done.stack is None else f", its calls take {done.stack} bytes of the stack at most"
    console.print(f"{out / done.name}.h: its memory has {done.bytes} bytes{stack}; README.md says how it is called")
