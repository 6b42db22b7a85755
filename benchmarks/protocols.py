"""The lecture's tables with every structure: both protocols, the input averaged and sampled, three seeds.

The same as `python -m studies.beam_lecture protocol 1|2 FOLDER --input averaged|sampled --json FILE`, four times. Needs
HYBRID_SYSID_DATA; see docs/bags.md.
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
from studies.beam_lecture.lecture import DATA

NAME = "protocols"


def main() -> int:
    """Run the four commands one after the other, write their results."""
    folder = os.environ.get(DATA)
    if not folder:
        print(f"skipped: {DATA} is not set, and the benchmark is about the real records", file=sys.stderr)
        return 0
    machine = result.machine()
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        for handling in ("averaged", "sampled"):
            for number in ("1", "2"):
                path = Path(place) / f"{number}_{handling}.json"
                command = [sys.executable, "-m", "studies.beam_lecture", "protocol", number, folder]
                if status := subprocess.run(
                    [*command, "--input", handling, "--json", str(path)], check=False
                ).returncode:
                    return status
                results[f"protocol {number}, {handling}"] = json.loads(path.read_text(encoding="utf-8"))
    print(result.write(NAME, results, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
