"""A board in the place of estimator and controller, as an option of run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer

from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop


@dataclass(frozen=True, kw_only=True)
class BoardLoop(Companion):
    """The controller asks a board, whose estimates it publishes; no estimator runs."""

    name: ClassVar[str] = "board"
    replaces: ClassVar[frozenset[str]] = frozenset({"estimator"})
    port: str
    baud: int

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        patience = {"board_patience": 5.0} if loop.lockstep else {}
        return {"controller": {"board": self.port, "board_baud": self.baud, "policy": "exact", **patience}}


def companion(
    board: Annotated[
        str, typer.Option("--board", help="Serial port of a board that runs the loop (export board).")
    ] = "",
    baud: Annotated[int, typer.Option(help="Rate of the serial line, in bits per second.")] = 115200,
) -> BoardLoop | None:
    """The board, where its port is given."""
    return BoardLoop(port=board, baud=baud) if board else None
