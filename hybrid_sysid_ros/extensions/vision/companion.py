"""What pictures do in a run: a camera in the sensors' place, or a picture as the goal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from hybrid_sysid_ros.extensions.vision import camera_loop
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Vision(Companion):
    """A camera that takes the sensors' place, a picture that the exact MPC makes the rig look like, or both."""

    name: ClassVar[str] = "vision"
    camera: bool = True
    """A bag then has the simulated rig's true motion, too."""
    layers: Path | str = ""
    """By which pictures are read, the shipped ones by default."""
    picture: Path | str = ""

    def check(self, loop: RequestedLoop) -> None:
        if not self.picture:
            return
        if "commander" in loop.companions:
            raise UserError("a picture is the goal, or commands say it: leave one out, and say 'look like PICTURE'")
        from hybrid_sysid_ros.extensions.vision.goal.goal_picture import reader_of, shown_in  # late: loads scipy

        shown_in(Path(self.picture), reader_of(rigs.load(loop.rig), self.layers))

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        found: NodeValues = {}
        if self.picture:
            picture = str(Path(self.picture).absolute())
            found["controller"] = {"picture": picture, "layers": str(self.layers), "policy": "exact"}
            found["reference"] = {} if loop.reference else {"kind": "constant", "amplitude": 0.0}
        if self.camera:
            found |= camera_loop.parameters(rigs.load(loop.rig), self.layers)
            found["recorder"] = {"further": "motion"}
            for node in ("camera", "vision"):
                found[node]["lockstep"] = loop.lockstep
            if not loop.simulated:
                del found["camera"]
        return found


def companion(
    camera: Annotated[
        bool,
        typer.Option("--camera", help="Close the loop by a simulated camera alone, with all other sensors out."),
    ] = False,
    layers: Annotated[
        Path | None, typer.Option(help="Folder of the layers that read pictures; the shipped ones by default.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            help="JPEG or PNG that shows the goal: the exact MPC minimises the squared difference of the pixels."
        ),
    ] = None,
) -> Vision | None:
    """Camera and picture, where one of them is asked for."""
    return Vision(camera=camera, layers=layers or "", picture=picture or "") if camera or picture else None
