"""hybrid-sysid export board: a loop on a microcontroller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.board.folder import BOARDS, MANIFEST, export_board, missing_tools
from hybrid_sysid_ros.extensions.export.exported_loop import Daqp, PolicyFolder, exported_loop
from hybrid_sysid_ros.support.files import check_folder


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="Folder for the board's sources.")],
    board: Annotated[
        Literal["m7", "m4"], typer.Option(help="Processor: Cortex-M7 in doubles, or Cortex-M4F in floats.")
    ] = "m7",
    rig: OwnRig = "",
    policy: PolicyFolder = None,
    daqp: Daqp = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rig's loop for a microcontroller, with a serial line, and replay it in the emulator."""
    check_folder(out, marker=MANIFEST, replace=overwrite)
    described, loaded, given = exported_loop(model, rig, policy, daqp)
    done, found = export_board(described, loaded, out, board=board, **given, overwrite=overwrite)
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
