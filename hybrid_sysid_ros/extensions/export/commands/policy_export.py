"""hybrid-sysid policy export: a policy without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Overwrite, OwnRig
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.control.policy.policy import SELF_CHECK_TOLERANCE
from hybrid_sysid_ros.extensions.export.policy_folder import Check, ExportFormat, export


def command(
    policy: Annotated[Path, typer.Argument(help="Policy folder.")],
    out: Annotated[Path, typer.Argument(help="Folder for the exported policy.")],
    form: Annotated[ExportFormat, typer.Option("--format", help="Format; onnx needs the extra [export].")] = "both",
    rig: OwnRig = "",
    overwrite: Overwrite = False,
) -> None:
    """Write a policy as an ONNX graph and as C99 without dependencies, if both answer as it does."""
    for check in export(policy, out, form=form, overwrite=overwrite):
        console.print(f"{out / check.file}: {described(check)}")


def described(check: Check) -> str:
    """How an exported file was checked, in a few words."""
    if not check.by:
        name = Path(check.file).stem
        return f"NOT CHECKED, for there is no C compiler here: cc -std=c99 -O2 {name}.c {name}_test.c -lm && ./a.out"
    return (
        f"answers as the policy does, to {check.largest_difference:.1e} "
        f"(tolerance {SELF_CHECK_TOLERANCE:g}; {check.by})"
    )
