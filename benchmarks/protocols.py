"""The lecture's tables with every structure: both protocols, the input averaged and sampled, three seeds; and the third
protocol, the input averaged. Only some of them: python -m benchmarks.protocols [protocols] [protocol_3].

The same as `python -m studies.beam_lecture protocol 1|2|3 FOLDER --input averaged|sampled --json FILE`, five times.
Needs HYBRID_SYSID_DATA; see docs/guides/bags.md.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import result
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.lecture import DATA

PARTS = {
    "protocols": [(number, handling) for handling in ("averaged", "sampled") for number in ("1", "2")],
    "protocol_3": [("3", "averaged")],
}
"""What is run, by the name of its results."""


def main() -> int:
    """Run the commands one after the other, write their results."""
    named = sys.argv[1:] or [*PARTS]
    for part in named:
        if part not in PARTS:
            raise UserError(f"no part {part}: known are {', '.join(PARTS)}")
    folder = os.environ.get(DATA)
    if not folder:
        print(f"skipped: {DATA} is not set, and the benchmark is about the real records", file=sys.stderr)
        return 0
    for part in named:
        machine = result.machine()
        results: dict[str, Any] = {}
        with tempfile.TemporaryDirectory() as place:
            for number, handling in PARTS[part]:
                path = Path(place) / f"{number}_{handling}.json"
                command = [sys.executable, "-m", "studies.beam_lecture", "protocol", number, folder]
                if status := subprocess.run(
                    [*command, "--input", handling, "--json", str(path)], check=False
                ).returncode:
                    return status
                results[f"protocol {number}, {handling}"] = json.loads(path.read_text(encoding="utf-8"))
        print(result.write(part, results, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
