"""Parts: the studies of a rig, each by its name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.errors import UserError

Part = Callable[[Rig], tuple[dict[str, Any], Sequence[Table]]]
"""What a study finds, as it is written, and the tables that show it."""


def run(rig: str, parts: Mapping[str, Part], *, name: str = "") -> int:
    """Run the parts that the command line names, or all; print their tables and write their results, as those of the
    rig where no other name is given. Raises UserError where there is no such part.
    """
    named = sys.argv[1:] or list(parts)
    for part in named:
        if part not in parts:
            raise UserError(f"no part {part}: known are {', '.join(parts)}")
    for part in named:
        machine = result.machine()
        found, tables = parts[part](load(rig))
        for table in tables:
            print_table(table)
        print(result.write(f"{name or rig}_{part}", found, on=machine))
    return 0
