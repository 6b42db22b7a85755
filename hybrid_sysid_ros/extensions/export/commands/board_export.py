"""hybrid-sysid export board: a loop on a microcontroller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hybrid_sysid_ros.commands.terminal import Overwrite, console
from hybrid_sysid_ros.extensions.export.board.folder import BOARDS, MANIFEST, export_board, missing_tools
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    out: Annotated[Path, typer.Argument(help="Folder for the board's sources.")],
    board: Annotated[
        Literal["m7", "m4"], typer.Option(help="Processor: Cortex-M7 in doubles, or Cortex-M4F in floats.")
    ] = "m7",
    rig: Annotated[str, typer.Option("--rig", help="Folder of the model's rig, if it is not known by name.")] = "",
    policy: Annotated[Path | None, typer.Option(help="Policy folder: it drives while it passes the check.")] = None,
    daqp: Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's loop for a microcontroller, with a serial line, and replay it in the emulator."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    loaded = load_model(model, rig=rig)
    driver = {} if policy is None else {"policy": "supervised", "policy_path": str(policy)}
    done, found = export_board(
        load_rig(rig or loaded.rig),
        loaded,
        out,
        board=board,
        settings={"real_time": True, **driver},
        seal=storage.digest(model, kind="model"),
        policy_seal="" if policy is None else storage.digest(policy, kind="policy"),
        source=daqp,
        overwrite=overwrite,
    )
    core, periods = BOARDS[board].core, done.periods["recorded"]
    if found is None:
        needed = "; ".join(f"{name}: {advice}" for name, advice in missing_tools().items())
        console.print(f"{out}: NOT RUN on the Cortex-{core}, for these are not installed: {needed}")
        return
    console.print(
        f"{out}: {periods} recorded periods on the Cortex-{core} as in Python, inputs to {found.difference:.1e}; "
        f"instructions of a period: first {found.first}, then median {found.median}, most {found.most}; "
        f"flash {found.flash} bytes, memory {found.ram} bytes, stack {found.stack} bytes at most"
    )
