"""Run the studies of the drill string: python -m benchmarks.drill_string [identification] [suppression]."""

from __future__ import annotations

import sys
from typing import Any

from benchmarks import result
from benchmarks.drill_string import identification, suppression
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

RIG = "drill_string"
PARTS = ("identification", "suppression")


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
        if part == "identification":
            found = identification.measured(rig)
            shown = identification.tables(found)
        else:
            found = suppression.measured(rig, load_model(configuration.shipped(RIG, "model")))
            shown = [suppression.table(found)]
        for table in shown:
            print_table(table)
        print(result.write(f"{RIG}_{part}", found, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
