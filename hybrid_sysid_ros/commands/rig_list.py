"""hybrid-sysid rig list: the rigs that are known by name."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Table

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console, end, print_table
from hybrid_sysid_ros.rigs.folder import find, names
from hybrid_sysid_ros.support.errors import UserError


def command(as_json: Json = False) -> None:
    """List the rigs that are known by name: those of this package, and of other packages' entry points."""
    table, rows, problems = Table("rig", "package", "folder"), dict[Path, list[str]](), list[str]()
    for name in names():
        try:
            folder = find(name)
            rows.setdefault(folder.path.resolve(), [folder.package]).insert(-1, name)
        except UserError as error:
            problems.append(str(error))
    if as_json:
        found = [
            {"names": called, "package": package, "folder": str(path)} for path, (*called, package) in rows.items()
        ]
        console.print(json.dumps(found, indent=2))
        return end(problems)
    for path, (*called, package) in rows.items():
        table.add_row(", ".join(called), package, str(path))
    print_table(table)
    end(problems)
