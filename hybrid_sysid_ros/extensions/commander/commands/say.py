"""hybrid-sysid say: a command in plain language, to a running loop, or simulated only."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import DriverChoice, RigName
from hybrid_sysid_ros.commands.terminal import console, end
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import processes

CLIENT = "hybrid_sysid_ros.extensions.commander.nodes.command_client"


def command(
    text: Annotated[str, typer.Argument(help="What the rig is to do, as in 'go to 0 slowly'.")],
    rig: RigName = "",
    dry: Annotated[bool, typer.Option("--dry", help="Simulate the command from rest; nothing moves.")] = False,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Confirm the command if the commander waits for that.")
    ] = False,
    model: Annotated[Path | None, typer.Option(help="With --dry: model folder; the shipped one by default.")] = None,
    policy: Annotated[
        DriverChoice | None, typer.Option(help="With --dry: what drives the rig; the rig's choice by default.")
    ] = None,
    layers: Annotated[
        Path | None,
        typer.Option(help="With --dry: folder of the layers that read pictures; the shipped ones by default."),
    ] = None,
    domain: Annotated[int | None, typer.Option(help="ROS domain; that of ROS_DOMAIN_ID by default.")] = None,
) -> None:
    """Say a command to the commander of a running loop; with --dry, or where there is no ROS, to a simulated one.

    A stop goes to the controller where there is no commander.
    """
    described = rigs.load(rig or rigs.default())
    if dry or not processes.has_ros():
        from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal

        desk = Rehearsal.of(described, model=model or "", policy=policy or "", folder=os.getcwd(), layers=layers or "")
        reply = desk.say(text)
        end([] if reply.accepted else [reply.line])
        console.print(f"simulated from rest: {reply.line}")
        return
    words = processes.module(CLIENT, described.source, "--say", text, *(["--confirm"] if confirm else []))
    sys.stdout.flush()
    os.execve(words[0], words, processes.environment(domain))  # from here on this process is the client's
