"""Interpreter: from a text to a checked and simulated plan, or to a refusal in a line; it moves nothing itself."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.command_interface import Reply
from hybrid_sysid_ros.extensions.commander.language.commands import Command, PictureTarget, Repeat, Sentence
from hybrid_sysid_ros.extensions.commander.language.descriptions import description
from hybrid_sysid_ros.extensions.commander.language.eyes import Eyes
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast, Simulator, Start
from hybrid_sysid_ros.extensions.commander.language.plan import ReferencePlan, plan_of
from hybrid_sysid_ros.extensions.commander.language.sentence import MOST
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(kw_only=True, eq=False)
class Interpreter:
    """Reads, plans and simulates the commands of one rig."""

    vocabulary: Vocabulary
    simulator: Simulator
    eyes: Eyes
    files: Files = field(default_factory=Files)
    last: Sentence | None = None
    """What was carried out last, as whoever carries it out says."""

    @classmethod
    def of(cls, simulator: Simulator, *, folder: str = "", layers: str = "") -> Interpreter:
        """That of a simulator's rig; folder: of files to follow; layers: by which pictures are read, the shipped ones
        by default.
        """
        vocabulary = Vocabulary.of(simulator.rig)
        eyes = Eyes(vocabulary=vocabulary, folder=layers)
        return cls(vocabulary=vocabulary, simulator=simulator, eyes=eyes, files=Files(folder=folder))

    def read(self, text: str) -> Sentence:
        """The commands of a text. Raises UserError for one that is not understood."""
        sentence = grammar.read(text, self.vocabulary, self.files)
        if not any(isinstance(command, Repeat | PictureTarget) for command in sentence.commands):
            return sentence
        parts = tuple(part for item in sentence.commands for part in self._unfolded(item))
        if len(parts) > MOST:
            raise UserError(f"{len(parts)} parts with those that are repeated: a command has {MOST} at most")
        return replace(sentence, commands=parts)

    def _unfolded(self, command: Command) -> tuple[Command, ...]:
        """What a command stands for."""
        if isinstance(command, PictureTarget):
            return (self.eyes.move(command),)
        if not isinstance(command, Repeat):
            return (command,)
        if self.last is None:
            raise UserError("nothing was carried out yet that could be repeated: say what to do")
        return self.last.commands

    def plan(self, sentence: Sentence, reference: Array) -> ReferencePlan:
        """The plan of commands from references (outputs,), as they are shown. Raises UserError for what the rig can't
        reach.
        """
        ability = self.simulator.ability
        return plan_of(sentence.commands, reference, self.vocabulary, ability, stops=sentence.stops)

    def forecast(self, plan: ReferencePlan, start: Start) -> Forecast:
        """What a plan comes to. Raises UserError where it is refused."""
        found = self.simulator.forecast(plan, start)
        if found.refusal:
            raise UserError(found.refusal)
        return found

    def description(self, sentence: Sentence) -> str:
        """A sentence as it was understood."""
        return description(sentence, self.vocabulary)

    def rehearse(self, text: str) -> Reply:
        """The answer to a text where no loop runs: from rest at 0."""
        try:
            sentence = self.read(text)
            if sentence.is_stop:
                return Reply(
                    text=text, accepted=True, line=f"{self.description(sentence)}: the inputs go to rest at once"
                )
            plan = self.plan(sentence, np.zeros(len(self.vocabulary.outputs)))
            forecast = self.forecast(plan, self.simulator.rest)
        except UserError as error:
            return Reply(text=text, accepted=False, line=str(error))
        line = f"{self.description(sentence)}: {forecast.line}"
        return Reply(text=text, accepted=True, line=line, values=forecast.values)
