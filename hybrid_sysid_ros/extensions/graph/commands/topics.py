"""hybrid-sysid topics: the topics that there are."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.table import Table

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.graph.asking import Domain, ask


def command(
    hz: Annotated[bool, typer.Option("--hz", help="Measure how many messages come in a second.")] = False,
    seconds: Annotated[float, typer.Option(help="Length of the measurement [s].", min=0.1, max=600.0)] = 2.0,
    domain: Domain = None,
    as_json: Json = False,
) -> None:
    """List the topics with their types and the numbers of their publishers and subscriptions."""
    found = ask("topics", seconds=seconds if hz else 0.0, domain=domain)
    if as_json:
        console.print(json.dumps(found, indent=2))
        return
    table = Table("topic", "type", "pub", "sub", *(["Hz"] if hz else []))
    for item in found:
        rate = [f"{item['hz']:.1f}" if item["hz"] is not None else ""] if hz else []
        table.add_row(item["topic"], item["type"], str(item["publishers"]), str(item["subscriptions"]), *rate)
    print_table(table)
