"""hybrid-sysid export fmu: a model, a simulated rig or a controller for simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import Overwrite, OwnRig, console
from hybrid_sysid_ros.extensions.export.fmu.export import FmuExport, export_controller, export_simulation
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="File to write, NAME.fmu.")],
    rig: OwnRig = "",
    plant: Annotated[bool, typer.Option("--plant", help="The rig's simulated plant in place of the model.")] = False,
    controller: Annotated[bool, typer.Option("--controller", help="Estimator and exact MPC of the model.")] = False,
    policy: Annotated[Path | None, typer.Option(help="Policy folder, for --controller: it drives if checked.")] = None,
    daqp: Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a functional mock-up unit, FMI 3.0 for co-simulation with its sources, if it answers as Python does."""
    check_file(out, suffix=".fmu", replace=overwrite)
    if plant and controller:
        raise UserError("--plant and --controller are two FMUs: write one after the other")
    if (policy or daqp) and not controller:
        raise UserError("--policy and --daqp are for --controller: add it, or leave them out")
    loaded = load_model(model, rig=rig)
    own, seal = load_rig(rig or loaded.rig), storage.digest(model, kind="model")
    if controller:
        driver = {} if policy is None else {"policy": "supervised", "policy_path": str(policy)}
        seals = {} if policy is None else {"policy_seal": storage.digest(policy, kind="policy")}
        done = export_controller(
            own, loaded, out, settings={"real_time": True, **driver}, seal=seal, source=daqp, overwrite=overwrite,
            **seals,
        )  # fmt: skip
    else:
        done = export_simulation(own, out, model=None if plant else loaded, seal=seal, overwrite=overwrite)
    console.print(f"{out}: {described(done)}")


def described(done: FmuExport) -> str:
    """What was written and how it was checked, in a few words."""
    what = f"{done.identifier}, FMI 3.0, a step every {done.period:g} s, {done.variables} variables; FMPy finds nothing"
    if done.difference is None:
        return f"{what}; NOT SIMULATED, and with sources alone, for there is no C compiler here for Linux"
    return f"{what}; {done.periods} steps as in Python, to {done.difference:.1e} ({done.by})"
