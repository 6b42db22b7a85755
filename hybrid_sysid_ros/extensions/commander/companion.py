"""The commander of a run that it is started with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop

LayersOption = Annotated[
    Path | None, typer.Option(help="Folder of the layers that read pictures; the shipped ones by default.")
]


@dataclass(frozen=True, kw_only=True)
class Commander(Companion):
    """Takes commands in plain language, armed where the plant is simulated. The run begins at rest and goes on, where
    no reference is asked for.
    """

    name: ClassVar[str] = "commander"
    beside: ClassVar[bool] = True
    layers: Path | str = ""
    """By which pictures are read, the shipped ones by default."""

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        rest = {} if loop.reference else {"kind": "constant", "amplitude": 0.0}
        own = {"armed": loop.simulated, "folder": loop.folder, "layers": str(self.layers)}
        return {"commander": own, "reference": {**rest, "stay": not loop.duration}}


def companion(
    commander: Annotated[
        bool,
        typer.Option(
            "--commander",
            help="Take commands in plain language (see hybrid-sysid say); the rig rests until the first one.",
        ),
    ] = False,
    layers: LayersOption = None,
) -> Commander | None:
    """The commander, where it is asked for."""
    return Commander(layers=layers or "") if commander else None
