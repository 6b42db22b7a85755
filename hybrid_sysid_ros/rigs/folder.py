"""A rig's folder: it is found by name, path or entry point, and its system.py is loaded.

The Python of a folder runs when the rig is loaded, with the user's rights. So a folder is only used from a path that
the user gave, from this package, or from a package that the user installed and named.
"""

from __future__ import annotations

import importlib
import os
import traceback
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs import outside
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import path_of

GROUP = "hybrid_sysid_ros.rigs"
"""Group of other packages' entry points; the value is a module, in whose folder the two files are."""
HOME = Path(__file__).parent
SYSTEM, VALUES = "system.py", "rig.yaml"
LONGEST_NAME = 100  # characters


@dataclass(frozen=True, kw_only=True)
class RigFolder:
    """A folder of a rig, and its package, if any."""

    name: str
    path: Path
    package: str = ""

    @property
    def texts(self) -> tuple[bytes, bytes]:
        """Of its files."""
        return (self.path / SYSTEM).read_bytes(), (self.path / VALUES).read_bytes()


def names() -> dict[str, str]:
    """The rigs that are known by name in any process, with their packages."""
    found = {path.parent.name: "hybrid_sysid_ros" for path in sorted(HOME.glob(f"[!_]*/{VALUES}"))}
    return found | {point.name: point.value for point in _points() if point.name not in found}


def find(rig: str | Path) -> RigFolder:
    """The folder of a rig. Text with a slash, "." or "~" in front, and any Path, is a path; other text a name.

    Raises UserError where there is no such rig, it lacks a file, or two rigs have the name.
    """
    text = str(rig)
    if isinstance(rig, Path) or "/" in text or text.startswith((".", "~")):
        return _by_path(path_of(rig, "its folder"))
    if path := next((path for path in outside.chosen_paths() if path.name == text), None):
        return _by_path(path)
    if text in names():
        return _named(text)
    near = f"; to run ./{text}, write ./{text}" if os.path.isdir(text) else ""
    known = ", ".join(names()) or "none"
    raise UserError(f"no rig {text!r}: known are {known}; give your own by its folder, as in ./my_rig{near}")


def systems_of(folder: RigFolder) -> tuple[System, dict[str, System]]:
    """The system of a rig and its further structures by name, from system.py.

    Raises UserError where its Python fails, or holds no system, or several of which none is called SYSTEM.
    """
    path = folder.path / SYSTEM
    module = _imported(folder)
    own = [item for item in vars(module).values() if _is_system(item) and item.__module__ == module.__name__]
    bases = {base for item in own for base in item.__mro__[1:]}
    final = [item for item in own if item not in bases]
    chosen = getattr(module, "SYSTEM", final[0] if len(final) == 1 else None)
    if chosen is None:
        listed = ", ".join(item.__name__ for item in final) or "none"
        raise UserError(f"{path}: needs one System (a class of hybrid_sysid_ros.core) or SYSTEM = ...; it has {listed}")
    structures = getattr(module, "STRUCTURES", {})
    if not isinstance(structures, dict):
        raise UserError(f"{path}: STRUCTURES is {structures!r}: it needs a name and a System each")
    made = {str(name): _made(item, f"{path}: STRUCTURES[{name!r}]") for name, item in structures.items()}
    return _made(chosen, f"{path}: SYSTEM"), made


def check_name(path: Path) -> None:
    """Raise UserError where the name of a folder is not possible for a rig, or belongs to another rig."""
    folder = path.resolve()
    if not (folder.name.isidentifier() and folder.name.isascii() and len(folder.name) <= LONGEST_NAME):
        raise UserError(
            f"{path}: the folder's name is the rig's, in topics too: use letters of ASCII, digits and "
            f"underscores, {LONGEST_NAME} at most, and begin with a letter"
        )
    other = next((path for path in outside.chosen_paths() if path.name == folder.name and path != folder), None)
    if place := other or names().get(folder.name):
        raise UserError(f"{path}: a rig is called {folder.name} already, in {place}; give the folder another name")


def _points() -> list[EntryPoint]:
    return sorted(set(_installed()), key=lambda point: (point.name, point.value))


@cache
def _installed() -> tuple[EntryPoint, ...]:
    """Entry points of rigs. They are read once in a process, since this reads the metadata of every package."""
    return tuple(entry_points(group=GROUP))


def _named(name: str) -> RigFolder:
    """The folder of a known name. Raises UserError where it is found in two places."""
    own = RigFolder(name=name, path=HOME / name, package=f"{__package__}.{name}")
    found = [own] if (own.path / VALUES).is_file() else []
    for point in (point for point in _points() if point.name == name):
        try:
            path = Path(str(importlib.import_module(point.value).__file__)).parent
        except (Exception, SystemExit) as error:  # another package's code can raise anything
            raise UserError(f"rig {name}: entry point {point.value} can't be imported: {_described(error)}") from error
        found.append(RigFolder(name=name, path=path, package=point.value))
    if len({folder.path.resolve() for folder in found}) > 1:
        places = " and ".join(folder.package for folder in found)
        raise UserError(f"two rigs are called {name}: in {places}; uninstall one, or rename it")
    return _checked(found[0])


def _by_path(path: Path) -> RigFolder:
    folder = path.resolve()
    if folder.is_file():
        raise UserError(f"{path}: is a file; a rig is a folder that holds {SYSTEM} and {VALUES}")
    if not folder.is_dir():
        raise UserError(f"{path}: no such folder; hybrid-sysid rig new {path} makes a small rig to begin with")
    if folder.name in names() and (known := _named(folder.name)).path.resolve() == folder:
        return known
    check_name(path)
    return _checked(RigFolder(name=folder.name, path=folder))


def _checked(folder: RigFolder) -> RigFolder:
    missing = [name for name in (SYSTEM, VALUES) if not (folder.path / name).is_file()]
    if missing:
        empty = "" if any(folder.path.iterdir()) else " (the folder is empty)"
        raise UserError(
            f"{folder.path}: has no {' and no '.join(missing)}{empty}; hybrid-sysid rig new shows what a rig needs"
        )
    return folder


def _imported(folder: RigFolder) -> ModuleType:
    """The module of system.py: that of its package, or one with a name that depends on the path."""
    path = folder.path / SYSTEM
    try:
        if folder.package and (folder.path / "__init__.py").is_file():
            return importlib.import_module(f"{folder.package}.{path.stem}")
        return outside.imported(folder.path)
    except (Exception, SystemExit) as error:  # a user's code can raise anything
        raise UserError(f"{path}: {_place(error, path)}{_described(error)}") from error


def _place(error: BaseException, path: Path) -> str:
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}: "
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"line {lines[-1]}: " if lines else ""


def _described(error: BaseException) -> str:
    """Type and text of an error, in a line."""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
    return kind + " ".join(text.split())[:200]


def _is_system(item: object) -> bool:
    return isinstance(item, type) and issubclass(item, System)


def _made(item: object, where: str) -> System:
    """A System from an instance or a class. Raises UserError for anything else, and for what can't be made."""
    if isinstance(item, System):
        return item
    if not _is_system(item):
        raise UserError(f"{where} is {item!r}: it needs a System, or a class of one")
    try:
        made = item()  # type: ignore[operator]
    except (Exception, SystemExit) as error:  # a user's code can raise anything
        raise UserError(f"{where}: can't be made: {_described(error)}") from error
    kind: Any = type(made)
    if "__dataclass_fields__" not in vars(kind):
        raise UserError(f"{where}: {kind.__name__} has no @dataclass(frozen=True, kw_only=True) above it: write it")
    for what in ("states", "inputs"):
        if not getattr(made, what):
            raise UserError(f'{where}: {kind.__name__} has no {what}: write {what} = ("name [unit]", ...)')
    return made  # type: ignore[no-any-return]
