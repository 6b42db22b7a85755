"""hybrid-sysid rig list: the rigs that are known by name."""

from __future__ import annotations

from rich.table import Table

from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.rigs.folder import names


def command() -> None:
    """List the rigs that are known by name: of this package, and of entry points of others."""
    table = Table("rig", "package")
    for name, package in names().items():
        table.add_row(name, package)
    print_table(table)
