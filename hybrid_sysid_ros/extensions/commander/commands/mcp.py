"""hybrid-sysid mcp: checked commands as tools for language models."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import RigName
from hybrid_sysid_ros.extensions.commander.commands.say import CLIENT
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import processes


def command(
    rig: RigName = "",
    dry: Annotated[bool, typer.Option("--dry", help="Simulate all commands from rest; nothing moves.")] = False,
    domain: Annotated[int | None, typer.Option(help="ROS domain; that of ROS_DOMAIN_ID by default.")] = None,
) -> None:
    """Serve a rig's commander to language models by the Model Context Protocol, over standard input and output.

    Every command passes the same checks as any other; confirming and arming are left to the operator.
    """
    # Says what to install, where that is missing.
    from hybrid_sysid_ros.extensions.commander.language.server import server

    described = rigs.load(rig or rigs.default())
    if dry:
        from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal

        server(described, Rehearsal.of(described, folder=os.getcwd())).run()
        return
    processes.check_ros()
    words = processes.module(CLIENT, described.source, "--serve")
    sys.stdout.flush()
    os.execve(words[0], words, processes.environment(domain))  # from here on this process is the client's
