"""hybrid-sysid get: parameters of a running node."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.graph.asking import Domain, LoopRig, NodeName, Timeout, ask


def command(
    node: NodeName,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="PARAMETER", help="Names of parameters; all by default.")
    ] = None,
    rig: LoopRig = "",
    timeout: Timeout = 5.0,
    domain: Domain = None,
    as_json: Json = False,
) -> None:
    """Show the values of parameters that a running node has, with their descriptions."""
    answer = ask("get", node=node, names=names or [], namespace=rig, timeout=timeout, domain=domain)
    if as_json:
        console.print(json.dumps({item["name"]: item["value"] for item in answer["parameters"]}, indent=2))
        return
    table = Table("parameter", "value", "description", title=answer["node"])
    for item in answer["parameters"]:
        table.add_row(item["name"], json.dumps(item["value"]), item["description"])
    print_table(table)
