"""Interpreter: from a text to a checked and simulated plan, or to a refusal in a line; it moves nothing itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.extensions.commander.language import commands, grammar
from hybrid_sysid_ros.extensions.commander.language.clauses import MOST
from hybrid_sysid_ros.extensions.commander.language.command_interface import Reply
from hybrid_sysid_ros.extensions.commander.language.draft import back_to
from hybrid_sysid_ros.extensions.commander.language.eyes import Eyes
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast, Simulator, Start
from hybrid_sysid_ros.extensions.commander.language.plan import plan_of
from hybrid_sysid_ros.extensions.commander.language.reference_plan import ReferencePlan
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

PATIENCE = 30.0
"""Seconds within which a condition comes true, or what waits for it is left out."""


class Carried(NamedTuple):
    """Commands that were carried out."""

    commands: tuple[commands.Command, ...]
    origin: Array
    """Where the references were before (outputs,), as they are shown."""


@dataclass(kw_only=True, eq=False)
class Interpreter:
    """Reads, plans and simulates the commands of one rig."""

    vocabulary: Vocabulary
    simulator: Simulator
    eyes: Eyes
    files: Files = field(default_factory=Files)
    last: Carried | None = None
    """What was carried out last, as whoever carries it out says."""

    @classmethod
    def of(cls, simulator: Simulator, *, folder: str = "", layers: str = "") -> Interpreter:
        """That of a simulator's rig; folder: of files to follow; layers: by which pictures are read, the shipped ones
        by default.
        """
        vocabulary = Vocabulary.of(simulator.rig)
        eyes = Eyes(vocabulary=vocabulary, folder=layers)
        return cls(vocabulary=vocabulary, simulator=simulator, eyes=eyes, files=Files(folder=folder))

    def read(self, text: str) -> commands.Sentence:
        """The commands of a text. Raises UserError for one that is not understood."""
        return self.unfolded(grammar.read(text, self.vocabulary, self.files))

    def unfolded(self, sentence: commands.Sentence, last: Carried | None = None) -> commands.Sentence:
        """With what was carried out last in the place of words for it; what waits for a condition is left as it is.

        last: what goes before, in place of what was noted.
        """
        last, parts = last or self.last, list[commands.Command]()
        for item in sentence.commands:
            moves = tuple(part for part in parts if not isinstance(part, commands.Wait))
            if isinstance(item, commands.Undo) and moves:
                parts.append(item)  # the plan knows from where these parts went
            elif isinstance(item, commands.Adjust) and item.noun != "speed" and moves:
                parts += self._adjusted(item, moves)
            else:
                parts += self._unfolded(item, last)
        if len(parts) > MOST:
            raise UserError(f"{len(parts)} parts with those that are repeated: a command has {MOST} at most")
        return replace(sentence, commands=tuple(parts))

    def _unfolded(self, command: commands.Command, last: Carried | None) -> tuple[commands.Command, ...]:
        """What a command stands for."""
        if isinstance(command, commands.PictureTarget):
            return (self.eyes.move(command),)
        if isinstance(command, commands.Adjust) and command.noun == "speed":
            (output,) = self.vocabulary.of_kind("speed")
            return (
                commands.Move(goals=(commands.Goal(output=output, value=command.value, share=True),), shape="smooth"),
            )
        if not isinstance(command, commands.Repeat | commands.Undo | commands.Adjust):
            return (command,)
        if last is None:
            raise UserError("nothing was carried out yet that could be repeated or changed: say what to do")
        if isinstance(command, commands.Adjust):
            return tuple(self._adjusted(command, last.commands))
        if isinstance(command, commands.Undo):
            return (back_to(last.origin, self.vocabulary, command),)
        if command.seconds is not None:
            return (self._prolonged(last.commands, command.seconds),)
        if not command.pace:
            return last.commands * command.times
        return tuple(
            replace(one, pace=command.pace) if isinstance(one, commands.Move | commands.Home) else one
            for one in last.commands
        )

    def _adjusted(self, command: commands.Adjust, last: Sequence[commands.Command]) -> list[commands.Command]:
        """The last swing with another amplitude or frequency."""
        swings = [one for one in last if isinstance(one, commands.Swing)]
        if len(swings) != 1 or swings[0].last_frequency:
            raise UserError(f"no swing was carried out last whose {command.noun} could change: say the whole command")
        (swing,) = swings
        now = swing.frequency if command.noun == "frequency" else 0.5 * abs(swing.high - swing.low)
        wanted = {"to": command.value, "by": now + command.value, "times": now * command.value}[command.how]
        if wanted <= 0.0:
            raise UserError(f"the {command.noun} would be {wanted:.4g}: it is {now:.4g}")
        if command.noun == "frequency":
            return [replace(swing, frequency=wanted)]
        middle, sign = 0.5 * (swing.low + swing.high), 1.0 if swing.high > swing.low else -1.0
        return [replace(swing, low=middle - sign * wanted, high=middle + sign * wanted)]

    def _prolonged(self, last: Sequence[commands.Command], seconds: float) -> commands.Swing:
        """The last swing for so long. Raises UserError where there was none."""
        swings = [one for one in last if isinstance(one, commands.Swing)]
        if len(swings) != 1 or len(last) > 1:
            raise UserError("no swing alone was carried out last: say how many times, as in 'repeat 3 times'")
        return replace(swings[0], seconds=seconds)

    def note(self, sentence: commands.Sentence, reference: Array) -> None:
        """Remember what is carried out, and from which references (outputs,)."""
        self.last = Carried(sentence.commands, np.array(reference))

    def plan(self, sentence: commands.Sentence, reference: Array) -> ReferencePlan:
        """The plan of commands from references (outputs,), as they are shown. Raises UserError for what the rig can't
        reach.
        """
        plan = plan_of(sentence.commands, reference, self.vocabulary, self.simulator.ability, stops=sentence.stops)
        condition = sentence.condition
        if sentence.commands and not sentence.guards and condition is not None and condition.output is not None:
            along = plan.values[:, condition.output] - condition.value
            if along[0] * along[-1] < 0.0:
                output = self.vocabulary.outputs[condition.output]
                raise UserError(
                    f"{output.name} passes {condition.value:.4g} {output.unit} on the way, where only a stop acts: say "
                    f"'go to {condition.value:.4g} {output.unit}, then' what follows"
                )
        return plan

    def forecast(self, plan: ReferencePlan, start: Start) -> Forecast:
        """What a plan comes to. Raises UserError where it is refused."""
        found = self.simulator.forecast(plan, start)
        if found.refusal:
            raise UserError(found.refusal)
        return found

    def story(self, sentence: commands.Sentence, plan: ReferencePlan) -> str:
        """A sentence as it was understood, in numbers."""
        parts = list(plan.story)
        if sentence.later is not None and sentence.condition is not None:
            last = Carried(sentence.commands, plan.values[0]) if sentence.commands else None
            later = self.plan(self.unfolded(sentence.later, last), commands.met(sentence.condition, plan.values[-1]))
            when, words = self.awaited(sentence.condition), "; then ".join(later.story) + sentence.later.because
            if sentence.guards:
                return f"{'; then '.join(parts)}; but {when} of its end{self.missed(sentence, plan)}: {words}"
            known = "" if sentence.condition.output is None or sentence.later.is_stop else " (simulated when it begins)"
            parts += [f"{when}{known}: {words}"]
        return "; then ".join(parts)

    def whole(self, sentence: commands.Sentence) -> commands.Sentence:
        """With the parts that wait for a time or for rest behind the others; those that wait for a value are not
        known to begin.
        """
        while (later := sentence.later) is not None and (when := sentence.condition) and when.output is None:
            origin = np.zeros(len(self.vocabulary.outputs))
            later = self.unfolded(later, Carried(sentence.commands, origin) if sentence.commands else None)
            waited = [commands.Wait(seconds=when.delay)] if when.delay else []
            sentence = replace(later, commands=(*sentence.commands, *waited, *later.commands))
        return sentence

    def missed(self, sentence: commands.Sentence, plan: ReferencePlan) -> str:
        """That a plan does not lead to the value that a stop waits for; "" where it does."""
        condition = sentence.condition
        assert condition is not None
        assert condition.output is not None
        if not self.vocabulary.outputs[condition.output].tracked:
            return ""
        along = plan.values[:, condition.output] - condition.value
        met = (condition.side * along >= 0.0).any() if condition.side else along.min() <= 0.0 <= along.max()
        return "" if met else ", which the plan does not reach"

    def awaited(self, condition: commands.Condition) -> str:
        """A condition in words."""
        if condition.output is not None:
            output = self.vocabulary.outputs[condition.output]
            comes = {0.0: "reaches", 1.0: "is above", -1.0: "is below"}[condition.side]
            return f"once {output.name} {comes} {condition.value:.4g} {output.unit}, within {PATIENCE:g} s"
        return f"after {condition.delay:.4g} s" if condition.delay else f"once nothing moves, within {PATIENCE:g} s"

    def rehearse(self, text: str, start: Start | None = None, reference: Array | None = None) -> Reply:
        """The answer to a text that nothing carries out, from a state and references (outputs,) as they are shown; by
        default from rest at 0.
        """
        try:
            sentence = self.read(text)
            if sentence.is_stop:
                what = "emergency stop" if sentence.emergency else "stop"
                return Reply(text=text, accepted=True, line=f"{what}: the inputs go to rest at once{sentence.because}")
            begin = np.zeros(len(self.vocabulary.outputs)) if reference is None else reference
            plan = self.plan(sentence, begin)
            whole = plan if sentence.guards else self.plan(self.whole(sentence), begin)
            forecast = self.forecast(whole, start or self.simulator.rest)
            line = f"{self.story(sentence, plan)}: {forecast.line}"
        except UserError as error:
            return Reply(text=text, accepted=False, line=str(error))
        return Reply(text=text, accepted=True, line=line, values=forecast.values, forecast=forecast)
