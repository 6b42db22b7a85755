"""Meaning: python -m benchmarks.meaning [PART...]; without a part all, and then benchmarks/results/meaning.json."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.meaning import mockup, shots, words
from benchmarks.meaning.rows import Row
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.support.errors import UserError

Part = Callable[[], tuple[Mapping[str, Any], list[Row]]]
PARTS: Mapping[str, Part] = {"words": words.measured, "shots": shots.measured, "mockup": mockup.measured}


def main() -> int:
    """Run the parts, write what they found, and name the rows that fall short."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.meaning", description=__doc__)
    parser.add_argument("parts", nargs="*", help=", ".join(PARTS))
    asked = parser.parse_args()
    machine, found, rows = result.machine(), {}, []
    for name in asked.parts or PARTS:
        if name not in PARTS:
            raise UserError(f"no part {name}: known are {', '.join(PARTS)}")
        found[name], own = PARTS[name]()
        rows += [(name, row) for row in own]
        table = Table("what", "asked", "measured", title=name)
        for row in own:
            limit = f"at most {row.asked:g}" if row.at_most else f"{row.asked:g}"
            table.add_row(row.name, limit, f"{row.measured:.4g}", style="red" if row.short else "")
        print_table(table)
    short = [f"{name}: {row.name}" for name, row in rows if row.short]
    told = [{"part": name, **vars(row)} for name, row in rows]
    if not asked.parts:
        print(result.write("meaning", {**found, "rows": told, "short": len(short)}, on=machine))
    print("\n".join([f"{len(short)} of {len(rows)} rows fall short", *short]))
    return 0


if __name__ == "__main__":
    result.run(main)
