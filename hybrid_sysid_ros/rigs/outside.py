"""Modules of rigs that are in no package, with names under this one.

A process passes the path of a rig that its user gave on to the processes that it starts, by an environment variable. So
they find the same rig by its name, and the classes of its system.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

VARIABLE = "HYBRID_SYSID_RIG_FOLDERS"
"""Environment variable with the folders of rigs that were given by their paths, a line each."""
FILE, TEXT = "system.py", "__text__"

__path__: list[str] = []  # makes a package of this module, without files of its own


def chosen_paths() -> list[Path]:
    """The folders of rigs that were given by path to this process, or to the one that started it."""
    return [Path(text) for text in os.environ.get(VARIABLE, "").splitlines() if text]


def tell(folder: Path) -> None:
    """Make a rig known by its name to this process and to those that it starts."""
    if folder not in chosen_paths():
        os.environ[VARIABLE] = "\n".join(map(str, [*chosen_paths(), folder]))


def module_of(folder: Path) -> str:
    """Full name of the module of a rig's system.py, one for each path."""
    return f"{__name__}.{folder.name}_{hashlib.sha256(str(folder).encode()).hexdigest()[:12]}"


def imported(folder: Path) -> ModuleType:
    """The module of a rig's system.py, read again where its text has changed, as notebooks and their users do."""
    tell(folder)
    name, text = module_of(folder), (folder / FILE).read_bytes()
    if name in sys.modules and vars(sys.modules[name]).get(TEXT, text) != text:
        del sys.modules[name]
    module = import_module(name)
    setattr(module, TEXT, text)
    return module


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(f"{__name__}."):
            return None
        folder = next((folder for folder in chosen_paths() if module_of(folder) == fullname), None)
        return spec_from_file_location(fullname, folder / FILE) if folder else None


sys.meta_path.append(_Finder())
