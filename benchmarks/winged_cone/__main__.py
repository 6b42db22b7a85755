"""Run the studies of the winged cone: python -m benchmarks.winged_cone [autopilot] [identification]."""

from __future__ import annotations

import sys
from typing import Any

from benchmarks import result
from benchmarks.winged_cone import autopilot, identification
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

RIG = "winged_cone"
PARTS = ("autopilot", "identification")


def main() -> int:
    """Run the parts that are named, or both; print their tables and write their results."""
    named = sys.argv[1:] or PARTS
    for part in named:
        if part not in PARTS:
            raise UserError(f"no part {part}: known are {', '.join(PARTS)}")
    rig = load(RIG)
    for part in named:
        machine = result.machine()
        found: dict[str, Any]
        if part == "autopilot":
            found = autopilot.measured(rig)
            shown = [autopilot.table(found)]
        else:
            found = identification.measured(rig)
            shown = identification.tables(found)
        for table in shown:
            print_table(table)
        print(result.write(f"{RIG}_{part}", found, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
