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


def run(rig: str, parts: Mapping[str, Part]) -> int:
    """Run the parts that the command line names, or all; print their tables and write their results. Raises UserError
    where there is no such part.
    """
    named = sys.argv[1:] or list(parts)
    for name in named:
        if name not in parts:
            raise UserError(f"no part {name}: known are {', '.join(parts)}")
    for name in named:
        machine = result.machine()
        found, tables = parts[name](load(rig))
        for table in tables:
            print_table(table)
        print(result.write(f"{rig}_{name}", found, on=machine))
    return 0
