"""Use of the stack: the most bytes that a unit's calls need, from the call graph that gcc writes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

FLAGS = ("-fstack-usage", "-fcallgraph-info=su")
"""Flags of gcc, from its edition 10 on."""

_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes \(([^)]*)\)')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


SOLVER = "daqp_"
"""What functions of the solver begin with. Two of them call each other, once for each constraint that is active."""


class _CallGraph:
    def __init__(self, folder: Path) -> None:
        self.bytes: dict[str, int] = {}
        self.calls: dict[str, set[str]] = {}
        self.repeated: set[str] = set()
        """Functions of the solver that call each other."""
        self._known: dict[str, int] = {}
        for path in folder.glob("*.ci"):
            text = path.read_text(encoding="utf-8")
            for name, size, kind in _NODE.findall(text):
                if "dynamic" in kind and "bounded" not in kind:
                    raise UserError(f"export: {name} has a stack of no known size")
                self.bytes[_plain(name)] = int(size)
            for source, target in _EDGE.findall(text):
                self.calls.setdefault(_plain(source), set()).add(_plain(target))

    def depth(self, name: str, above: tuple[str, ...] = ()) -> int:
        """Bytes under a function, where those that call each other do it once."""
        if name in above:
            turn = above[above.index(name) :]
            if not all(item.startswith(SOLVER) for item in turn):
                raise UserError(f"export: {name} calls itself: {' -> '.join([*above, name])}")
            self.repeated.update(turn)
            return 0
        if name not in self._known:
            below = (self.depth(other, (*above, name)) for other in sorted(self.calls.get(name, ())))
            self._known[name] = self.bytes.get(name, 0) + max(below, default=0)
        return self._known[name]


def most_bytes(folder: Path, functions: Sequence[str], *, constraints: int) -> int:
    """The most bytes of the stack under any of the functions, by the graphs (*.ci) in a folder; those of the C library,
    such as tanh, are not counted. constraints: most that are active in the solver.

    Raises UserError for another function than the solver's that calls itself, and for one without a bound.
    """
    graph = _CallGraph(folder)
    most = max(graph.depth(name) for name in functions)
    return most + constraints * sum(graph.bytes.get(name, 0) for name in graph.repeated)


def _plain(name: str) -> str:
    """A function's name without its file, for static functions have it."""
    return name.rpartition(":")[2]
