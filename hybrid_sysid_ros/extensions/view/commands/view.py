"""hybrid-sysid view: a running rig on a page of this computer."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import RigName
from hybrid_sysid_ros.commands.terminal import console, status
from hybrid_sysid_ros.extensions.view.companion import PORT, Port, address
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.runtime.run import interruptible
from hybrid_sysid_ros.runtime.session import READY_TIMEOUT, Session
from hybrid_sysid_ros.support.progress import Report


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


def view(*, rig: str, port: int, show: Callable[[str], None], domain: int | None = None, tell: Report = print) -> None:
    """Show a rig that others run on a page, until an interrupt. show: gets the page's address. Raises UserError without
    ROS, where the port is taken, and where the view ended early.
    """
    with interruptible(), Session(rig, domain=domain, tell=tell) as session:
        with suppress(KeyboardInterrupt):
            priority = processes.priority_of("view", processes.permitted_priority())
            session.start("view", session.command("view", {"port": port, "priority": priority}))
            session.wait_for("ready", ["view"], READY_TIMEOUT)
            show(address(session.said))
            session.wait_for_end(["view"], lambda seconds: None)
        session.stop()
        session.check_end()


def _has_screen() -> bool:
    """Whether a browser would be more than text in this terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
