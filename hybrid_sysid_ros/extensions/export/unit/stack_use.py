"""Use of the stack: the most bytes that a unit's calls need, from the call graph that gcc writes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

FLAGS = ("-fstack-usage", "-fcallgraph-info=su")
"""Flags of gcc, from its edition 10 on."""

_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes \(([^)]*)\)')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


def most_bytes(folder: Path, functions: Sequence[str]) -> int:
    """The most bytes of the stack under any of the functions, by the graphs (*.ci) in a folder; those of the C library,
    such as tanh, are not counted.

    Raises UserError for a function that calls itself, and for one without a bound.
    """
    bytes_of: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for path in folder.glob("*.ci"):
        text = path.read_text(encoding="utf-8")
        for name, size, kind in _NODE.findall(text):
            if "dynamic" in kind and "bounded" not in kind:
                raise UserError(f"export: {name} has a stack of no known size")
            bytes_of[_plain(name)] = int(size)
        for source, target in _EDGE.findall(text):
            calls.setdefault(_plain(source), set()).add(_plain(target))
    known: dict[str, int] = {}
    return max(_depth(name, bytes_of, calls, known, ()) for name in functions)


def _plain(name: str) -> str:
    """A function's name without its file, for static functions have it."""
    return name.rpartition(":")[2]


def _depth(
    name: str,
    bytes_of: Mapping[str, int],
    calls: Mapping[str, set[str]],
    known: dict[str, int],
    above: tuple[str, ...],
) -> int:
    if name in above:
        raise UserError(f"export: {name} calls itself: {' -> '.join([*above, name])}")
    if name not in known:
        below = (_depth(other, bytes_of, calls, known, (*above, name)) for other in calls.get(name, ()))
        known[name] = bytes_of.get(name, 0) + max(below, default=0)
    return known[name]
