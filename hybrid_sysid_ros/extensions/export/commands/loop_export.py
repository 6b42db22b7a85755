"""hybrid-sysid export loop: a loop without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import Overwrite, console
from hybrid_sysid_ros.extensions.export.unit.folder import MANIFEST, MOST, export_loop
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
    policy: Annotated[Path | None, typer.Option(help="Policy folder: it drives while it passes the check.")] = None,
    single: Annotated[bool, typer.Option("--single", help="Floats in place of doubles.")] = False,
    daqp: Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's loop, its estimator and controller, as C99 without allocation, if it answers as in Python."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    loaded = load_model(model, rig=rig)
    driver = {} if policy is None else {"policy": "supervised", "policy_path": str(policy)}
    done = export_loop(
        load_rig(rig or loaded.rig),
        loaded,
        out,
        settings={"real_time": real_time, **driver},
        policy_seal="" if policy is None else storage.digest(policy, kind="policy"),
        seal=storage.digest(model, kind="model"),
        source=daqp,
        single=single,
        overwrite=overwrite,
    )
    for kind, parts in done.differences.items():
        most = f" in {MOST:.0%} of them" if kind == "odd" else ""
        console.print(
            f"{out / done.name}.c: {done.periods[kind]} {kind} periods as in Python, "
            f"inputs{most} to {parts['inputs']:.1e} "
            f"(tolerance {done.tolerances[kind]:g}; {done.by})"
        )
    stack = "" if done.stack is None else f", its calls take {done.stack} bytes of the stack at most"
    console.print(f"{out / done.name}.h: its memory has {done.bytes} bytes{stack}; README.md says how it is called")
