"""Eyes: where a picture shows the rig, as a goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from hybrid_sysid_ros.extensions.commander.language.commands import Goal, Move, PictureTarget
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError


class ReadsPictures(Protocol):
    """What an extension provides that reads pictures."""

    @property
    def joint(self) -> str:
        """That pictures show."""
        ...

    def position(self, path: Path, name: str = "") -> float:
        """Of the joint [rad] in a picture, which the user calls by a name. Raises UserError where it shows none."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Eyes:
    """Reads pictures of one rig by its layers."""

    vocabulary: Vocabulary
    folder: str = ""
    """Of the layers, those that are shipped by default."""

    @cached_property
    def reader(self) -> ReadsPictures:
        """Raises UserError where there are no layers of the rig, or nothing that reads pictures is installed."""
        if not (targets := list(extensions.targets("pictures").values())):
            raise UserError("no extension that reads pictures is installed: name a value instead")
        made: ReadsPictures = extensions.loaded(targets[0])(self.vocabulary.rig, self.folder)
        return made

    @cached_property
    def output(self) -> int:
        """The output that pictures show. Raises UserError where that is none, or is not steered."""
        vocabulary, joint = self.vocabulary, self.reader.joint
        shown = vocabulary.rig.joints.joints[joint].position
        for k in vocabulary.tracked:
            if vocabulary.outputs[k].name == shown:
                return k
        raise UserError(f"pictures show the position of {joint}, and the controller does not steer that")

    def move(self, command: PictureTarget) -> Move:
        """What a picture asks for. Raises UserError where it does not show the rig as the layers know it."""
        position = self.reader.position(command.path, command.name)
        goal = Goal(output=self.output, value=float(position / self.vocabulary.outputs[self.output].scale))
        return Move(
            goals=(goal,), shape="smooth", pace=command.pace, seconds=command.seconds, hold=command.hold,
            picture=command.name,
        )  # fmt: skip
