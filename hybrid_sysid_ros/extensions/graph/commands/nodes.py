"""hybrid-sysid nodes: the nodes that run."""

from __future__ import annotations

import json

from rich.table import Table

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.extensions.graph.asking import Domain, ask


def command(domain: Domain = None, as_json: Json = False) -> None:
    """List the running nodes, with what each reports of its tasks in the diagnostics."""
    found = ask("nodes", domain=domain)
    if as_json:
        console.print(json.dumps(found, indent=2))
        return
    table = Table("node", "task", "level", "message")
    for node in found:
        for task in node["tasks"] or [{"task": "", "level": "", "message": "publishes no diagnostics"}]:
            table.add_row(node["node"], task["task"], task["level"], task["message"])
    print_table(table)
