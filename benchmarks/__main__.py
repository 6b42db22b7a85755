"""Run all benchmarks, or those named: python -m benchmarks [NAME...], or every published table: all-tables."""

from __future__ import annotations

import pkgutil
import subprocess
import sys
from pathlib import Path

HELPERS = {
    *(
        "__main__",
        "acados_peer",
        "browser",
        "network_plant",
        "parts",
        "picture",
        "result",
        "step_response",
    ),
    *("all_tables", "mutants", "newest"),  # of the tables, the tests and the dependencies
}
KNOWN = [entry.name for entry in pkgutil.iter_modules([str(Path(__file__).parent)]) if entry.name not in HELPERS]


def main(names: list[str]) -> int:
    """Run each benchmark in a process of its own; return 1 if one failed, 2 if there is none of that name."""
    if {"-h", "--help"} & {*names}:
        print(f"{__doc__}\nThey are {', '.join(KNOWN)}; each writes benchmarks/results/NAME.json.")
        return 0
    if names[:1] == ["all-tables"]:
        from benchmarks import all_tables

        return all_tables.main(names[1:])
    unknown = [name for name in names if name not in KNOWN]
    if unknown:
        print(f"error: no benchmark {unknown[0]}: known are {', '.join(KNOWN)}", file=sys.stderr)
        return 2
    failed = []
    for name in names or KNOWN:
        print(f"== {name}", flush=True)
        if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=False).returncode:
            failed.append(name)
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
