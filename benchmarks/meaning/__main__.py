"""Meaning: python -m benchmarks.meaning [PART...]; the parts that are run replace theirs in results/meaning.json."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.meaning import films, friction, mockup, shots, words
from benchmarks.meaning.rows import Row
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.support.errors import UserError

NAME = "meaning"
Part = Callable[[], tuple[Mapping[str, Any], list[Row]]]
PARTS: Mapping[str, Part] = {
    "words": words.measured,
    "films": films.measured,
    "friction": friction.measured,
    "shots": shots.measured,
    "mockup": mockup.measured,
}


def main() -> int:
    """Run the parts, write what each found as soon as it is done, and name the rows that fall short."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.meaning", description=__doc__)
    parser.add_argument("parts", nargs="*", help=", ".join(PARTS))
    asked = parser.parse_args().parts or list(PARTS)
    if unknown := [name for name in asked if name not in PARTS]:
        raise UserError(f"no part {unknown[0]}: known are {', '.join(PARTS)}")
    machine, kept = result.machine(), _kept()
    for name in asked:
        figures, rows = PARTS[name]()
        table = Table("what", "asked", "measured", title=name)
        for row in rows:
            limit = f"at most {row.asked:g}" if row.at_most else f"{row.asked:g}"
            table.add_row(row.name, limit, f"{row.measured:.4g}", style="red" if row.short else "")
        print_table(table)
        kept[name] = {**figures, "rows": [{**vars(row), "short": row.short} for row in rows]}
        told = [(part, row) for part in PARTS if part in kept for row in kept[part]["rows"]]
        short = [f"{part}: {row['name']}" for part, row in told if row["short"]]
        path = result.write(NAME, {**kept, "short": len(short)}, on=machine)
    print("\n".join([str(path), f"{len(short)} of {len(told)} rows fall short", *short]))
    return 0


def _kept() -> dict[str, Any]:
    """What an earlier run found, by part."""
    try:
        found = json.loads((result.RESULTS / f"{NAME}.json").read_text(encoding="utf-8"))["results"]
    except FileNotFoundError:
        return {}
    return {name: found[name] for name in PARTS if name in found}


if __name__ == "__main__":
    result.run(main)
