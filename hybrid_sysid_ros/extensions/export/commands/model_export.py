"""hybrid-sysid model export: a model as CasADi functions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.casadi_functions import STEP
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.library.policies import export
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="Folder for step.casadi, output.casadi and model.json.")],
    step: Annotated[float, typer.Option(help="Length of the exported step [s]; 0: the model's own step.")] = 0.0,
    smoothing: Annotated[
        float, typer.Option(help="Velocity over which stick-slip is rounded, for solvers; 0: exact.", min=0.0)
    ] = 0.0,
    rig: OwnRig = "",
    overwrite: Overwrite = False,
) -> None:
    """Write a model as CasADi functions, for do-mpc, acados or a script."""
    check_folder(out, marker=STEP, replace=overwrite)
    loaded = load_model(model, rig=rig)
    export(loaded, out, step=step, smoothing=smoothing, overwrite=overwrite)
    console.print(
        f"{out}: step(x, u) and output(x, u) of {loaded.structure} {loaded.rig}; casadi.Function.load reads them"
    )
