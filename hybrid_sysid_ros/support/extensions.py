"""Extensions: folders beside the trunk, and other packages, add to it by manifests of plain data.

An extension of this distribution is a folder of ``extensions/`` with an extension.py; one of another distribution names
its manifest by an entry point. Each is used as a whole or not at all. Modules that a manifest names are imported only
when they are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from operator import attrgetter
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.support import errors
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.manifest import Extension
from hybrid_sysid_ros.support.trunk import NEIGHBOURS, TRUNK

GROUP = "hybrid_sysid_ros.extensions"
"""Group of other packages' entry points; the value is the manifest, MODULE:EXTENSION."""
HOME = Path(__file__).parents[1] / "extensions"
MANIFEST = "extension.py"
PACKAGE = __name__.partition(".")[0]


@dataclass(frozen=True, kw_only=True)
class Registry:
    """The manifests of the trunk and of the extensions in use, and a line for each other one with the reason."""

    extensions: tuple[Extension, ...]
    problems: list[str]


@cache
def registry() -> Registry:
    """All installed extensions, which are looked for once in a process: our own by name, then those of others."""
    used, problems = [TRUNK], list[str]()
    taken = dict.fromkeys((("command", words.split()[0]) for words in TRUNK.commands), TRUNK.name)
    taken |= dict.fromkeys([("extension", TRUNK.name), *TRUNK.claims()], TRUNK.name)
    for where, target in _targets():
        try:
            found = loaded(target)
            if not isinstance(found, Extension):
                raise UserError(f"{target} is {found!r}: it needs an Extension")
            for kind, name in (("extension", found.name), *found.claims()):
                if (kind, name) in taken:
                    raise UserError(f"its {kind} {name} is there already, in {taken[kind, name]}: rename one of them")
        except UserError as error:
            problems.append(f"extension {where} is left out: {error}")
            continue
        taken |= dict.fromkeys([("extension", found.name), *found.claims()], found.name)
        used.append(found)
    return Registry(extensions=tuple(used), problems=problems)


def installed() -> tuple[Extension, ...]:
    """The extensions that are used, without the trunk."""
    return registry().extensions[1:]


def commands() -> dict[str, tuple[str, str]]:
    """Module and summary of every command, the trunk's first, by its words."""
    return {words: entry for item in registry().extensions for words, entry in item.commands.items()}


def node_module(name: str) -> str:
    """Full name of the module that runs a node. Raises UserError where there is none."""
    nodes = {node: module for extension in registry().extensions for node, module in extension.nodes.items()}
    if name not in nodes:
        raise UserError(f"no node {name}: {missing(name) or errors.known(name, nodes)}")
    return nodes[name]


def targets(kind: str) -> dict[str, str]:
    """The objects of a kind as "module:attribute" by name; nothing is imported."""
    return {name: target for item in registry().extensions for name, target in item.provides.get(kind, {}).items()}


def provided(kind: str) -> dict[str, Any]:
    """The objects of a kind by name. One that can't be imported is left out, and reported among the problems."""
    found = {}
    for name, target in targets(kind).items():
        try:
            found[name] = loaded(target)
        except UserError as error:
            leave_out(f"{kind} {name} of an extension", error)
    return found


def one(kind: str, name: str, needs: str = "") -> Any:
    """The object of a kind and name. needs: beginning of the error, with the extension that is needed. Raises UserError
    where no extension provides it, or it can't be imported.
    """
    if (target := targets(kind).get(name)) is None:
        raise UserError(
            f"{needs or f'{kind} {name}'}: no extension that provides it is installed: install one that does"
        )
    return loaded(target)


def leave_out(what: str, why: UserError) -> None:
    """Note that part of an extension is not used; the command line reports it."""
    if (line := f"{what} is left out: {why}") not in registry().problems:
        registry().problems.append(line)


def missing(name: str) -> str:
    """Why a command, node, structure or option of an extension of ours is not there; empty where that is not why."""
    for owner, names in NEIGHBOURS.items():
        if any(name == known or name.startswith(f"{known}_") for known in names):
            reasons = [line for line in registry().problems if line.startswith(f"extension {owner} ")]
            absent = f"its extension {owner} is missing: {HOME / owner} is not there; install hybrid_sysid_ros again"
            return next(iter(reasons), "" if (HOME / owner / MANIFEST).exists() else absent)
    return ""


def left_out() -> str:
    """End of a line that refuses a name that an extension may have: which extensions are left out, and why."""
    return "".join(f"; {line}" for line in registry().problems)


def loaded(target: str) -> Any:
    """The object that "module:attribute" names. Raises UserError where its import raises anything."""
    module, _, attribute = target.partition(":")
    with blaming(f"{target} can't be imported"):
        return attrgetter(attribute)(import_module(module))


@contextmanager
def blaming(what: str, module: str = "") -> Iterator[None]:
    """Around code that may be another package's: turn its errors into a UserError of one line that begins with
    ``what``. Errors of this package's modules are not changed.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, UserError | Interrupted) or module.startswith(f"{PACKAGE}."):
            raise
        raise UserError(f"{what}: {type(error).__name__}: {' '.join(str(error).split())[:200]}") from error


def _targets() -> Iterator[tuple[str, str]]:
    """Name and manifest of each extension that may be there."""
    for path in sorted(HOME.glob(f"*/{MANIFEST}")):
        name = path.parent.name
        yield name, f"{GROUP}.{name}.{path.stem}:EXTENSION"
    points: set[EntryPoint] = set(entry_points(group=GROUP))
    yield from sorted((f"{point.name} ({point.value})", point.value) for point in points)
