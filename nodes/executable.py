"""Executable: the entry point of the nodes' executables, which finds the node by the executable's name."""

from __future__ import annotations

import os
import shutil
import sys
from importlib import import_module
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import node_module

SECOND_TRY = "HYBRID_SYSID_SECOND_TRY"
"""Environment variable that is set when another Python has tried before."""


def main() -> int:
    """Start the node that has the executable's name; return 2 where no available Python has its dependencies.

    colcon --symlink-install writes its own Python into executables, which may lack packages of pip: then the first
    Python in the path, such as that of an active environment, is used.
    """
    name = Path(sys.argv[0]).stem.removeprefix("hybrid-sysid-")
    try:
        module = node_module(name)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        return int(import_module(module).main())
    except ModuleNotFoundError as error:
        start_again(module)
        print(
            f"error: {sys.executable} has no module {error.name}: activate the environment that hybrid_sysid_ros's "
            "dependencies were installed into, or install them for this Python (docs/install.md)",
            file=sys.stderr,
        )
        return 2


def start_again(module: str) -> None:
    """Run a module with the same arguments under the first Python in the path, if that was not tried."""
    other = shutil.which("python3")
    if other and Path(other).parent != Path(sys.executable).parent and not os.environ.get(SECOND_TRY):
        os.environ[SECOND_TRY] = "1"
        os.execv(other, [other, "-m", module, *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
