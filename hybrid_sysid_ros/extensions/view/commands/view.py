"""hybrid-sysid view: a running rig on a page of this computer."""

from __future__ import annotations

import os
import sys
import webbrowser
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.terminal import PORT, Port, RigName, console, status
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.run import view


def command(
    rig: RigName = "",
    port: Port = PORT,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address and open nothing.")] = False,
) -> None:
    """Show a running rig on a page of this computer, whoever has started it, and drive it from there, until Ctrl-C."""

    def show(url: str) -> None:
        console.print(url)
        if not no_browser and _has_screen():
            webbrowser.open(url)

    view(rig=rig or rigs.default(), port=port, tell=status.print, show=show)


def _has_screen() -> bool:
    """Whether a browser would be more than text in this terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
