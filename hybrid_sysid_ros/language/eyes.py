"""Eyes: where a picture shows the rig, as a goal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from hybrid_sysid_ros.camera import jpeg
from hybrid_sysid_ros.language.commands import Goal, Look, Move
from hybrid_sysid_ros.language.vocabulary import Vocabulary
from hybrid_sysid_ros.runtime.shipped import shipped
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.vision.angle_reader import STANDS, AngleReader
from hybrid_sysid_ros.vision.layers import Layers


@dataclass(frozen=True, kw_only=True, eq=False)
class Eyes:
    """Reads pictures of one rig by its layers."""

    vocabulary: Vocabulary
    folder: str = ""
    """Of the layers, those that are shipped by default."""

    @cached_property
    def reader(self) -> AngleReader:
        """Raises UserError where there are no layers of the rig, or what opens pictures is not installed."""
        jpeg.check_available()
        rig = self.vocabulary.rig
        layers = Layers.load(self.folder or shipped(rig.name, "layers"))
        if layers.geometry.rig != rig.name:
            raise UserError(f"the layers are of the rig {layers.geometry.rig}, not of {rig.name}")
        made = AngleReader(layers)
        made.read(layers.drawn(layers.geometry.low).astype("uint8"))  # compiles
        return made

    @cached_property
    def output(self) -> int:
        """The output that pictures show. Raises UserError where that is none, or is not steered."""
        vocabulary, joint = self.vocabulary, self.reader.layers.geometry.joint
        shown = vocabulary.rig.joints.joints[joint].position
        for k in vocabulary.tracked:
            if vocabulary.outputs[k].name == shown:
                return k
        raise UserError(f"pictures show the position of {joint}, and the controller does not steer that")

    def move(self, command: Look) -> Move:
        """What a picture asks for. Raises UserError where it does not show the rig as the layers know it."""
        reader, output = self.reader, self.vocabulary.outputs[self.output]
        joint, rig = reader.layers.geometry.joint, self.vocabulary.rig.name
        try:
            picture = jpeg.opened(command.path)
            reading = reader.read(picture)
        except UserError as error:
            raise UserError(f"{command.name[:60]}: {error}") from error
        if reading.found and reader.standing(picture) < STANDS:
            raise UserError(
                f"{command.name[:60]}: what stands in it does not look as it should: it is of another place, or the "
                "camera was moved since the layers were learned"
            )
        if not reading.found:
            geometry = reader.layers.geometry
            low, high = (reader.layers.position(end) for end in (geometry.low, geometry.high))
            raise UserError(
                f"{command.name[:60]}: does not show the {joint} of {rig} where its layers know it, from "
                f"{math.degrees(low):.3g} to {math.degrees(high):.3g} degrees"
            )
        value = reader.layers.position(reading.angle) / output.scale
        goal = Goal(output=self.output, value=float(value))
        return Move(
            goals=(goal,), shape="smooth", pace=command.pace, seconds=command.seconds, hold=command.hold,
            picture=command.name,
        )  # fmt: skip
