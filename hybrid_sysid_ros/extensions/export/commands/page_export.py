"""hybrid-sysid export page: the rig and its controller in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import ModelFolder, Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.export.exported_loop import Daqp, exported_loop
from hybrid_sysid_ros.extensions.export.page.export import PERIODS, export_page
from hybrid_sysid_ros.support.files import check_file


def command(
    model: ModelFolder,
    out: Annotated[Path, typer.Argument(help="File to write, NAME.html.")],
    rig: OwnRig = "",
    policy: Annotated[Path | None, typer.Option(help="Policy folder: it can drive, too, supervised.")] = None,
    daqp: Daqp = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a page on which the identified rig and its controller run, without a server, if they run as in Python."""
    check_file(out, suffix=".html", replace=overwrite)
    described, loaded, given = exported_loop(model, rig, policy, daqp)
    done = export_page(described, loaded, out, **given, overwrite=overwrite)
    for name, difference in done.differences.items():
        console.print(f"{out}: {PERIODS} periods with the controller {name} as in Python, to {difference:.1e} (node)")
    if not done.differences:
        console.print(f"{out}: NOT CHECKED, for there is no node here, which runs the page's code")
    console.print(f"{out}: {done.bytes / 1e3:.0f} kB; open it in a browser")
