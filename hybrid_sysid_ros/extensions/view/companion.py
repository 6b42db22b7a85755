"""The live view of a run that it is started with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer

from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop

PORT = 8400
Port = Annotated[int, typer.Option(help="Port of the live view's page; 0 takes any free one.", min=0, max=65535)]


@dataclass(frozen=True, kw_only=True)
class View(Companion):
    """A page that shows the run, which then goes on when a reference of the rig's own has ended."""

    name: ClassVar[str] = "view"
    beside: ClassVar[bool] = True
    port: int = PORT
    """0: any that is free."""

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        return {"view": {"port": self.port}, "reference": {"stay": not loop.duration}}

    def ready(self, said: Callable[[str], set[str]]) -> str:
        return f"live view: {address(said)}"


def address(said: Callable[[str], set[str]]) -> str:
    """Where the page is, by the words of its node."""
    return next((word for word in said("view") if word.startswith("http://")), "")


def companion(
    view: Annotated[
        bool, typer.Option("--view", help="Show the run in the live view, and continue until Ctrl-C.")
    ] = False,
    port: Port = PORT,
) -> View | None:
    """The live view, where it is asked for."""
    return View(port=port) if view else None
