"""hybrid-sysid play: the messages of a bag again."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Recover
from hybrid_sysid_ros.runtime import node_commands, processes


def command(
    bag: Annotated[Path, typer.Argument(help="Bag to play.")],
    rate: Annotated[float, typer.Option(help="Speed of playing, as a multiple of the recorded speed.")] = 1.0,
    start: Annotated[float, typer.Option(help="Time at the beginning of the bag that is left out [s].", min=0.0)] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Play the bag again when it ends.")] = False,
    clock: Annotated[bool, typer.Option("--clock", help="Publish the time of the bag on /clock.")] = False,
    topics: Annotated[
        str, typer.Option(help="Names of the topics to play, separated by spaces; all topics by default.")
    ] = "",
    pause: Annotated[
        bool, typer.Option("--pause", help="Start paused: the space key plays, the right arrow steps.")
    ] = False,
    recover: Recover = False,
) -> None:
    """Publish the messages of a bag again, as they are, with the quality of service that was offered.

    In a terminal the space key pauses and goes on, the right arrow publishes one message more, Ctrl-C ends.
    """
    processes.check_ros()
    values = {"bag": str(bag), "rate": rate, "start": start, "loop": loop, "clock": clock, "topics": topics}
    words = node_commands.command("player", {**values, "pause": pause, "recover": recover})
    sys.stdout.flush()
    os.execve(words[0], words, processes.environment())  # from here on this process is the player's
