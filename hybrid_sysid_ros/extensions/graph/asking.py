"""Asking: questions to the running nodes, put by a process of its own that has the environment of ROS."""

from __future__ import annotations

import json
import subprocess
from typing import Annotated, Any

import typer

from hybrid_sysid_ros.runtime import processes

CLIENT = "hybrid_sysid_ros.extensions.graph.nodes.graph_client"
SLOW = 120.0
"""Seconds that setting a parameter may take: a model is loaded, checked and compiled."""


def _namespace(rig: str) -> str:
    if not rig:
        return ""  # at once: a loop that must stop waits for no rig's equations
    from hybrid_sysid_ros.rigs.rig import load

    return f"/{load(rig).namespace}"


def _names() -> list[str]:
    from hybrid_sysid_ros.rigs.folder import names

    return [*names()]


LoopRig = Annotated[
    str,
    typer.Option(
        "--rig", help="Rig whose nodes are meant; needed where several run.", callback=_namespace, autocompletion=_names
    ),
]
"""Becomes the namespace of its nodes."""
NodeName = Annotated[str, typer.Argument(help="Name of the node, such as controller, or /left/controller.")]
Timeout = Annotated[float, typer.Option("--timeout", help="Time to wait for the answer [s].", min=0.1, max=3600.0)]
Domain = Annotated[int | None, typer.Option(help="ROS domain; that of ROS_DOMAIN_ID by default.", min=0, max=232)]


def ask(question: str, *, domain: int | None, **given: Any) -> Any:
    """The answer to a question, a method of :class:`.nodes.graph_client.GraphClient`, as plain data.

    Raises UserError without ROS, and typer.Exit where the client has said what is wrong.
    """
    processes.check_ros()
    words = processes.module(CLIENT, json.dumps({"question": question, **given}))
    client = subprocess.run(words, env=processes.environment(domain), stdout=subprocess.PIPE, text=True, check=False)
    if client.returncode:
        raise typer.Exit(client.returncode)
    return json.loads(client.stdout)
