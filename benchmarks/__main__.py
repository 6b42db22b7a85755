"""Run all benchmarks, or those named: python -m benchmarks [NAME...]."""

from __future__ import annotations

import pkgutil
import subprocess
import sys
from pathlib import Path

HELPERS = {"__main__", "acados_peer", "network_plant", "picture", "result"}


def main(names: list[str]) -> int:
    """Run each benchmark in a process of its own; return 1 if one failed, 2 if there is none of that name."""
    known = [entry.name for entry in pkgutil.iter_modules([str(Path(__file__).parent)]) if entry.name not in HELPERS]
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"error: no benchmark {unknown[0]}: known are {', '.join(known)}", file=sys.stderr)
        return 2
    failed = []
    for name in names or known:
        print(f"== {name}", flush=True)
        if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=False).returncode:
            failed.append(name)
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
