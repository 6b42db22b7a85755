"""A line that says why nothing happens while code is compiled, where somebody waits."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

from numba.core import event


class Announcement(event.Listener):  # type: ignore[misc]
    """Says once per process that something is compiled that is not kept on disk yet."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: Any) -> None:
        if not self._said and (sys.stderr.isatty() or "ipykernel" in sys.modules):
            self._said = True
            print("compiling once, which can take minutes: the code is kept on disk", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        pass


@cache
def announce_compiling() -> None:
    """From now on, say at a terminal or in a notebook when the first function is compiled."""
    event.register("numba:compile", Announcement())
