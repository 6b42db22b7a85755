"""Eyes: where a picture shows the rig, as a goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hybrid_sysid_ros.extensions.commander.language.commands import Goal, Look, Move
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class Eyes:
    """Reads pictures of one rig by its layers."""

    vocabulary: Vocabulary
    folder: str = ""
    """Of the layers, those that are shipped by default."""

    @cached_property
    def reader(self) -> AngleReader:
        """Raises UserError where there are no layers of the rig, or what opens pictures is not installed."""
        from hybrid_sysid_ros.extensions.vision.goal.goal_picture import reader_of  # late: it loads scipy's optimisers

        made = reader_of(self.vocabulary.rig, self.folder)
        drawn = made.layers.drawn(made.layers.geometry.low).astype("uint8")
        made.read(jpeg.decoded(jpeg.encoded(drawn, 80)))  # compiles for what a file gives
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
        from hybrid_sysid_ros.extensions.vision.goal.goal_picture import shown_in

        _, position = shown_in(command.path, self.reader, command.name)
        goal = Goal(output=self.output, value=float(position / self.vocabulary.outputs[self.output].scale))
        return Move(
            goals=(goal,), shape="smooth", pace=command.pace, seconds=command.seconds, hold=command.hold,
            picture=command.name,
        )  # fmt: skip
