"""Goal pictures: where a picture shows a rig, and the controller whose cost is in the picture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.goal.picture_mpc import ImageErrorModel, PictureMpc, error_model
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import STANDS, AngleReader
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import mpc_problem
from hybrid_sysid_ros.runtime.controllers import ConfiguredController, pace
from hybrid_sysid_ros.runtime.parameters import defaults, shipped
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.errors import UserError

LONGEST = 60  # characters of a name that are shown
BEYOND = math.radians(0.5)
"""By which a position may lie beyond those that the layers were learned from."""


def reader_of(rig: Rig, folder: Path | str = "") -> AngleReader:
    """What reads pictures of a rig; folder: of its layers, the shipped ones by default. Raises UserError where there
    are none, or what opens pictures is not installed.
    """
    jpeg.check_available()
    layers = PictureLayers.load(folder or shipped(rig.name, "layers"))
    if layers.geometry.rig != rig.name:
        raise UserError(f"the layers are of the rig {layers.geometry.rig}, not of {rig.name}")
    return AngleReader(layers)


def shown_in(path: Path, reader: AngleReader, name: str = "") -> tuple[Picture, float]:
    """A picture, and the position of the joint [rad] in it; name: what the user calls it.

    Raises UserError where it is no picture, of another size, of another place or by a camera that was moved, or does
    not show the joint where the layers know it.
    """
    label, geometry = name[:LONGEST] or str(path), reader.layers.geometry
    try:
        picture = jpeg.opened(path)
        reading = reader.read(picture)
    except UserError as error:
        raise UserError(f"{label}: {error}") from error
    known = reader.layers.full_turn or geometry.low - BEYOND <= reading.angle <= geometry.high + BEYOND
    if not (reading.found and known):
        low, high = (math.degrees(reader.layers.position(end)) for end in (geometry.low, geometry.high))
        raise UserError(
            f"{label}: does not show the {geometry.joint} of {geometry.rig} where its layers know it, from {low:.3g} "
            f"to {high:.3g} degrees"
        )
    if reader.standing([reader.scenery(picture)]) < STANDS:
        raise UserError(
            f"{label}: what stands in it does not look as it should: it is of another place, or the camera was moved "
            "since the layers were learned"
        )
    return picture, reader.layers.position(reading.angle)


@dataclass(frozen=True, eq=False)
class PictureReader:
    """Tells where pictures show the joint of a rig, for other extensions."""

    reader: AngleReader

    @classmethod
    def of(cls, rig: Rig, folder: Path | str = "") -> PictureReader:
        """That of a rig, compiled for what a file gives. Raises UserError: see reader_of()."""
        made = reader_of(rig, folder)
        drawn = made.layers.drawn(made.layers.geometry.low).astype("uint8")
        made.read(jpeg.decoded(jpeg.encoded(drawn, 80)))
        return cls(made)

    @property
    def joint(self) -> str:
        return self.reader.layers.geometry.joint

    def position(self, path: Path, name: str = "") -> float:
        """Of the joint [rad] in a picture. Raises UserError: see shown_in()."""
        return shown_in(path, self.reader, name)[1]


def controller(rig: Rig, model: Model, settings: Mapping[str, Any]) -> ConfiguredController:
    """The exact MPC whose cost is in the picture that the settings name. Raises UserError: see goal_of()."""
    if settings["policy"] != "exact" or settings["solver"] != "sqp":
        raise UserError("parameter picture: only the exact MPC weighs pictures: policy:=exact, solver:=sqp")
    system = goal_of(rig, model.system, settings)
    problem = mpc_problem(settings, rig, system)
    return ConfiguredController(controller=PictureMpc(system, problem, **pace(settings)), problem=problem)


def goal_of(rig: Rig, system: System, settings: Mapping[str, Any]) -> ImageErrorModel:
    """The system of a controller that is to make the rig look like the picture that its settings name. Raises UserError
    where the picture shows no goal: see shown_in(); or one that is out of reach, or the rig has other outputs.
    """
    path, reader = Path(settings["picture"]), reader_of(rig, settings["layers"])
    shown, (output, *others) = rig.joints.joints[reader.layers.geometry.joint].position, set_point_ranges(rig)
    if others or output.name != shown:
        raise UserError(f"parameter picture: pictures show {shown or 'no position'}, the one output must be that")
    picture, position = shown_in(path, reader)
    value = position / output.scale
    if not output.low <= value <= output.high:
        raise UserError(
            f"{path}: shows {output.name} at {value:.4g} {output.unit}, out of reach: stay within {output.low:.4g} and "
            f"{output.high:.4g} {output.unit}"
        )
    renderer = LayerRenderer(reader.layers, exposure=defaults(rig, "camera")["exposure"])
    low, high = output.scale * output.low, output.scale * output.high
    return error_model(system, shown, renderer, picture, reader.swept, low=low, high=high)
