"""Public sets with official splits and starts, every kind of structure: the same as python -m studies.public.

Needs HYBRID_SYSID_DATA, the folder in which public/ has the files; see docs/results/public.md.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from benchmarks import result
from studies.public.study import DATA

KEPT = Path("out") / "public.json"


def main() -> int:
    """Run the study, which goes on where it was interrupted, and write its results."""
    if not os.environ.get(DATA):
        print(f"skipped: {DATA} is not set, and the benchmark is about public records", file=sys.stderr)
        return 0
    machine = result.machine()
    if status := subprocess.run(
        [sys.executable, "-m", "studies.public", "run", "--json", str(KEPT)], check=False
    ).returncode:
        return status
    print(result.write("public", json.loads(KEPT.read_text(encoding="utf-8")), on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
