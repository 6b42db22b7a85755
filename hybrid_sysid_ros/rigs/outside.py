"""Modules of rigs that are in no package, by names under this one.

What a process was told by its user, the path of a rig, it tells the processes that it starts: they find the same rig by
its name, and the classes of its system, without being given the path again.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

VARIABLE = "HYBRID_SYSID_RIG_FOLDERS"
"""Of the environment: the folders of rigs that were named by their paths, a line each."""
FILE = "system.py"

__path__: list[str] = []  # makes a package of this module, with nothing of its own in it


def chosen_paths() -> list[Path]:
    """The folders of rigs that this process, or the one that started it, was given by path."""
    return [Path(text) for text in os.environ.get(VARIABLE, "").splitlines() if text]


def tell(folder: Path) -> None:
    """Let this process and those that it starts know a rig by its name."""
    if folder not in chosen_paths():
        os.environ[VARIABLE] = "\n".join(map(str, [*chosen_paths(), folder]))


def module_of(folder: Path) -> str:
    """Full name of the module of a rig's system.py, one for each path."""
    return f"{__name__}.{folder.name}_{hashlib.sha256(str(folder).encode()).hexdigest()[:12]}"


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(f"{__name__}."):
            return None
        folder = next((folder for folder in chosen_paths() if module_of(folder) == fullname), None)
        return spec_from_file_location(fullname, folder / FILE) if folder else None


sys.meta_path.append(_Finder())
