"""hybrid-sysid export fmu: a model, a simulated rig or a controller for simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.exported_loop import Daqp, exported_loop
from hybrid_sysid_ros.extensions.export.fmu.export import FmuExport, export_controller, export_simulation
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="File to write, NAME.fmu.")],
    rig: OwnRig = "",
    plant: Annotated[bool, typer.Option("--plant", help="The rig's simulated plant in place of the model.")] = False,
    controller: Annotated[bool, typer.Option("--controller", help="Estimator and exact MPC of the model.")] = False,
    policy: Annotated[Path | None, typer.Option(help="Policy folder, for --controller: it drives if checked.")] = None,
    daqp: Daqp = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a functional mock-up unit, FMI 3.0 for co-simulation with its sources, if it answers as Python does."""
    check_file(out, suffix=".fmu", replace=overwrite)
    if plant and controller:
        raise UserError("--plant and --controller are two FMUs: write one after the other")
    if (policy or daqp) and not controller:
        raise UserError("--policy and --daqp are for --controller: add it, or leave them out")
    own, loaded, given = exported_loop(model, rig, policy, daqp)
    if controller:
        done = export_controller(own, loaded, out, **given, overwrite=overwrite)
    else:
        done = export_simulation(own, out, model=None if plant else loaded, seal=given["seal"], overwrite=overwrite)
    console.print(f"{out}: {described(done)}")


def described(done: FmuExport) -> str:
    """What was written and how it was checked, in a few words."""
    what = f"{done.identifier}, FMI 3.0, a step every {done.period:g} s, {done.variables} variables; FMPy finds nothing"
    if done.difference is None:
        return f"{what}; NOT SIMULATED, and with sources alone, for there is no C compiler here for Linux"
    return f"{what}; {done.periods} steps as in Python, to {done.difference:.1e} ({done.by})"
