"""Adjustments: what a clause says of the last swing, or of a speed that is there, in place of where to go."""

from __future__ import annotations

import math

from hybrid_sysid_ros.extensions.commander.language import commands
from hybrid_sysid_ros.extensions.commander.language.clauses import Quantity
from hybrid_sysid_ros.extensions.commander.language.goals import Goals
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.notes import LITTLE, MORE
from hybrid_sysid_ros.extensions.commander.language.values import described
from hybrid_sysid_ros.rigs.units import FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError


class Adjustments(Goals):
    """Takes what a clause changes."""

    def move(self, shape: str) -> commands.Move:
        """To one or several goals."""
        raise NotImplementedError

    def go(self) -> commands.Command:
        clause = self.clause
        if clause.comparatives and not self.changed():
            return self.compared()
        adjusted = clause.nouns or [self.adjusted(item) for item in self.left if self.adjusted(item)]
        return self.adjust(adjusted[0]) if adjusted else self.move("smooth")

    def adjusted(self, item: Quantity) -> str:
        """Which noun of the last swing a quantity changes; "": none. "The same at 1 Hz" needs no noun."""
        if item.base == FREQUENCY and {symbol.value for symbol in self.clause.verbs} <= {"repeat"}:
            return "frequency"
        if item.kind == "peak_to_peak":
            return "amplitude"
        return item.kind if item.kind in ("amplitude", "frequency", "period") else ""

    def changed(self) -> bool:
        """Whether a comparison says by how much a speed changes, as "5 rpm faster" does; it is a direction then."""
        ((factor, text), *more), speeds = self.clause.comparatives, self.vocabulary.of_kind("speed")
        senses = {math.copysign(1.0, other - 1.0) for other, _ in more} | {way.value for way in self.clause.directions}
        if senses == {math.copysign(1.0, factor - 1.0)} and len(self.left) == 1:
            more, self.clause.directions = [], []  # "a bit slower, 5 rpm less"
        if not more and len(self.left) == 1 and self.left[0].base == PERCENT and self.left[0].role in ("", "by"):
            share = 0.01 * abs(self.left.pop().value)  # "20 % faster" is of what it is
            self.clause.comparatives = [(1.0 + math.copysign(share, factor - 1.0), text)]
            return False
        if (
            more
            or len(self.left) != 1
            or self.left[0].role not in ("", "by")
            or self.output(self.left[0]) not in speeds
        ):
            return False
        self.clause.comparatives = []
        self.clause.directions.append(Symbol("U", math.copysign(1.0, factor - 1.0), text))
        return True

    def compared(self) -> commands.Command:
        """What "slower" asks for: of a speed another value, of the last swing another frequency."""
        ((factor, text), *more) = self.clause.comparatives
        again = any(symbol.value == "repeat" for symbol in self.clause.verbs)
        if again and self.vocabulary.of_kind("speed"):
            raise UserError(
                f"{text!r}: the same again with more time, or at another speed? say 'repeat slowly', or {text!r}"
            )
        if self.clause.nouns and {*self.clause.nouns} <= {"amplitude", "frequency"} and not more and not self.left:
            return self.larger(factor)
        if more or self.left or self.clause.shares:
            raise UserError(f"{text!r} by how much? say it alone, or a value alone, as in 'go to 1 {self.example}'")
        speeds, targets = self.vocabulary.of_kind("speed"), self.clause.targets
        if targets and targets != speeds:
            raise UserError(f"{text!r} is of a speed, or of the last swing: say what of {self.vocabulary.steered}")
        targets, self.clause.comparatives, self.clause.targets = speeds, [], []
        return commands.Adjust(noun="speed" if len(targets) == 1 else "frequency", value=factor, how="times")

    def larger(self, factor: float) -> commands.Command:
        """The last swing, larger or more often. Raises UserError for two of these."""
        nouns = {*self.clause.nouns}
        if self.clause.targets:
            raise UserError("larger is of the last swing: say by how much the value goes up or down, as 'up a bit'")
        if len(nouns) > 1:
            raise UserError(f"{' and '.join(sorted(nouns))}: which? say one of them")
        self.clause.nouns, self.clause.comparatives = [], []
        return commands.Adjust(noun=nouns.pop(), value=factor, how="times")

    def adjust(self, noun: str) -> commands.Command:
        """Another amplitude, frequency or period of the last swing."""
        clause = self.clause
        sign = self.direction()
        quantity = self.take(lambda item: item.kind == "" or self.adjusted(item) == noun)
        share = clause.shares.pop() if clause.shares else None
        clause.nouns, clause.directions = [], []
        if quantity is None and share is None and sign:  # "a bit more amplitude"
            step, clause.bit = LITTLE if clause.bit else MORE, ""
            return self.multiplied(noun, 1.0 + sign * step)
        if (quantity is None) == (share is None):
            raise UserError(f"{noun} to what? say for example 'swing with an amplitude of 1 {self.example} at 0.5 Hz'")
        if share is not None:
            factor = share.factor if share.role != "by" else 1.0 + (sign or 1.0) * share.factor
            return self.multiplied(noun, factor)
        assert quantity is not None
        relative = quantity.role == "by" or (sign != 0.0 and quantity.role == "")
        if quantity.base == PERCENT:
            factor = 0.01 * quantity.value
            return self.multiplied(noun, 1.0 + (sign or 1.0) * factor if relative else factor)
        if noun == "period":
            if quantity.base != TIME or relative:
                raise UserError(f"{quantity.text!r}: say how long a period is to be, as in 'set the period to 4 s'")
            return commands.Adjust(noun="frequency", value=1.0 / self.time(quantity), how="to")
        if noun == "frequency" and quantity.base != FREQUENCY:
            raise UserError(f"{described(quantity)} is no frequency: give it in Hz")
        output = self.output(quantity)
        value = quantity.said if noun == "frequency" else self.value(quantity, output, relative=True)
        value *= 0.5 if quantity.kind == "peak_to_peak" else 1.0
        return commands.Adjust(
            noun=noun, value=(sign or 1.0) * value if relative else value, how="by" if relative else "to"
        )

    def multiplied(self, noun: str, factor: float) -> commands.Adjust:
        """So many times the noun; of a period the frequency is as much less. Raises UserError for a factor of 0."""
        if noun == "period" and factor <= 0.0:
            raise UserError("a period of 0 is none: say half, or how long it is to be")
        return commands.Adjust(
            noun="frequency" if noun == "period" else noun, value=1.0 / factor if noun == "period" else factor,
            how="times",
        )  # fmt: skip
