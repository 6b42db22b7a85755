"""The body of a demo's loop: what runs it in the place of Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.extensions.shared.demo_loop import OUT
from hybrid_sysid_ros.rigs.rig import Rig, default

DemoBody = Annotated[
    str,
    typer.Option(
        "--body", help="Close the loop in C instead: native, a process of this computer; m7 or m4, an emulated board."
    ),
]


def demo_folder(out: Path | None, body: str, rig: Rig) -> Path:
    """Folder of a demo's results, by default one of the body and of a rig that is not the default."""
    return out or OUT.with_name(f"demo_{body}" if rig.name == default() else f"demo_{body}_{rig.name}")
