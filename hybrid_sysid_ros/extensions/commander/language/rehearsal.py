"""Rehearsal: commands without a loop; every one is simulated, by default from rest, and nothing moves."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.commander.language.command_interface import CommandInterface, Reply, RigState
from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator, Start
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.questions import answered, is_question
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.arrays import Array


class Rehearsal(CommandInterface):
    """A desk with an interpreter behind it. One command is simulated at a time: the controller remembers."""

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter, self._simulating = interpreter, Lock()

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

    @property
    def system(self) -> System:
        """Of the model that simulates."""
        return self._interpreter.simulator.model.system

    def say(self, text: str) -> Reply:
        return self.check(text)

    def check(self, text: str) -> Reply:
        if is_question(text):
            return Reply(text=text, accepted=True, line=answered(self.state(), self._interpreter.vocabulary.rig))
        return self.check_from(text)

    def check_from(self, text: str, start: Start | None = None, reference: Array | None = None) -> Reply:
        """The same from a state, with references (outputs,) as they are shown; by default from rest."""
        with self._simulating:
            return self._interpreter.rehearse(text, start, reference)

    def stop(self) -> Reply:
        return self._interpreter.rehearse("stop")

    def state(self) -> RigState:
        rig = self._interpreter.vocabulary.rig
        outputs = {f"{item.name} [{item.unit}]": 0.0 for item in self._interpreter.vocabulary.outputs}
        references = {
            f"{item.name} [{item.unit}]": 0.0 for item in self._interpreter.vocabulary.outputs if item.tracked
        }
        named = zip(rig.system.inputs, rig.actuators, strict=True)
        inputs = {f"{item.name} [{item.unit}]": actuator.rest for item, actuator in named}
        return RigState(live=False, outputs=outputs, references=references, inputs=inputs)
