"""Rehearsal: commands without a loop; every one is simulated from rest, and nothing moves."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply
from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import shipped


class Rehearsal(CommandInterface):
    """A desk with an interpreter behind it."""

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter

    @classmethod
    def of(
        cls, rig: Rig, *, model: Path | str = "", policy: str = "", folder: str = "", layers: Path | str = ""
    ) -> Rehearsal:
        """That of a rig. model: folder, the shipped one by default. policy: another one than the rig's. folder: of
        files to follow. layers: by which pictures are read, the shipped ones by default. Raises UserError where no
        model is given and none is shipped.
        """
        used = load(model or shipped(rig.name, "model"), rig=rig.source)
        return cls(Interpreter.of(Simulator.of(rig, used, policy=policy), folder=folder, layers=str(layers)))

    def say(self, text: str) -> Reply:
        return self.check(text)

    def check(self, text: str) -> Reply:
        return self._interpreter.rehearse(text)

    def stop(self) -> Reply:
        return self._interpreter.rehearse("stop")
