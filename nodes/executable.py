"""Executable: what the nodes' executables start, each by its own name."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path


def main() -> int:
    """Start the node that the executable is named after; 2 where this Python lacks something that it needs."""
    name = Path(sys.argv[0]).stem.removeprefix("hybrid-sysid-")
    try:
        module = import_module(f"hybrid_sysid_ros.nodes.{name}")
    except ModuleNotFoundError as error:
        print(
            f"error: {sys.executable} has no module {error.name}: activate the environment that hybrid_sysid_ros's "
            "dependencies were installed into, or install them for this Python (docs/install.md)",
            file=sys.stderr,
        )
        return 2
    return int(module.main())


if __name__ == "__main__":
    sys.exit(main())
