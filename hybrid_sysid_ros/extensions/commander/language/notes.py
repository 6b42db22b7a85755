"""Notes: what the patterns of a clause come to, slot by slot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from hybrid_sysid_ros.extensions.commander.language.clauses import Awaited, Clause, IncompleteError, Quantity, Share
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME, Unit
from hybrid_sysid_ros.support.errors import UserError

LITTLE, MORE, MUCH = 0.1, 0.2, 0.5
"""By which "a bit slower", "slower" and "much slower" change a speed or a frequency."""


class FilledSlot(NamedTuple):
    """What a pattern has found."""

    slot: str
    part: Sequence[Symbol]
    letters: str
    quantities: Sequence[tuple[float, Unit | None]]
    output: int | None = None

    @property
    def text(self) -> str:
        return " ".join(symbol.text for symbol in self.part if symbol.text)

    @property
    def noun(self) -> str:
        return next((str(symbol.value) for symbol in self.part if symbol.kind in "Kakfq"), "")

    @property
    def names(self) -> Sequence[Symbol]:
        return [symbol for symbol in self.part if symbol.kind in "KO"]


class Notes:
    """Of one clause."""

    def __init__(self, part: Sequence[Symbol], vocabulary: Vocabulary) -> None:
        first = part[0].value
        self.part, self.vocabulary = part[first in ("then", "while") :], vocabulary
        goes = any(symbol.kind == "J" and symbol.text.endswith("ing") for symbol in part)
        self.made = Clause(then=first == "then", meanwhile=first == "while", going=goes)
        said = [symbol for symbol in self.part if symbol.kind not in "yJOK"]
        self.made.neighbours = [pair for pair in pairwise(said) if pair[0].kind == pair[1].kind == "V"]
        self.output: int | None = None
        """That was named last."""
        self.waiting = False
        """Whether it has no value yet."""
        self.noun = ""

    @property
    def example(self) -> str:
        return self.vocabulary.outputs[self.vocabulary.tracked[0]].unit if self.vocabulary.tracked else ""

    # What is noted, by slots.

    def _note_value(self, found: FilledSlot) -> None:
        role = {"plain": "", "rate": "at"}.get(found.slot, found.slot)
        self.made.quantities.append(
            self.quantity(found.quantities[0], role, found.text, kind=found.noun, output=found.output)
        )

    def _note_condition(self, found: FilledSlot) -> None:
        when, side = found.part[0].value
        reached = None
        if found.quantities:
            reached = self.quantity(found.quantities[0], "to", found.text, output=found.output)
        self.made.condition = Awaited(when, reached, side)

    def _note_ends(self, found: FilledSlot) -> None:
        self.made.quantities += [
            self.quantity(said, found.slot, found.text, output=found.output) for said in found.quantities
        ]

    def _note_limit(self, found: FilledSlot) -> None:
        """The upper end of the range."""
        factor = -1.0 if any(symbol.value == "lowest" for symbol in found.part) else 1.0
        self.made.shares.append(Share(factor=factor, role="to", text=found.text, of="range", word=""))
        self.made.targets += [found.output] if found.output is not None else []

    def _note_full_speed(self, found: FilledSlot) -> None:
        """A value; behind "at" how another one is gone to."""
        if any(symbol.value == "lowest" for symbol in found.part):
            self._note_limit(found._replace(output=self.named(found.names)))
            return
        if found.noun != "speed" and found.output not in self.vocabulary.of_kind("speed"):
            self._note_limit(found._replace(output=self.named(found.names)))
            return
        if "W" in found.letters:
            self.made.at_full_speed = found.text
        else:
            self.made.full_speed = found.text

    def _note_of_swing(self, found: FilledSlot) -> None:
        """An amplitude, frequency or period."""
        role = "to" if "T" in found.letters else "by" if "Y" in found.letters else ""
        before = self.made.quantities[-1] if self.made.quantities and not role else None
        if found.noun == "period" and before and before.base == TIME and not is_time(found.quantities[0][1]):
            self.made.quantities[-1] = replace(before, kind="period")  # "4 s period, 3 cycles"
            self._note_value(found._replace(slot="plain", part=[each for each in found.part if each.kind == "Q"]))
            return
        self.made.quantities.append(self.quantity(found.quantities[0], role, found.text, kind=found.noun or found.slot))

    def _note_often(self, found: FilledSlot) -> None:
        """As in "one cycle every 4 s". Raises UserError for a count that could be that of all periods."""
        (count, unit), every = found.quantities
        own = [each for k in self.vocabulary.tracked for each in self.vocabulary.units_of(k)]
        if every[1] is not None and every[1].base == COUNT and is_time(unit):  # "5 s at each, six times"
            self._note_each(found)
            self.made.quantities.append(self.quantity(every, "", found.text))
            return
        if (
            unit is not None
            and every[1] is not None
            and is_time(every[1])
            and any(map(unit.rate.alike, own))
            and every[0] > 0.0
        ):
            self._note_value(
                found._replace(slot="plain", quantities=[(count / (every[0] * every[1].factor), unit.rate)])
            )
            return  # "one turn every 4 s"
        if unit is None or unit.base != COUNT:
            self.made.quantities.append(self.quantity(found.quantities[0], "", found.text))
        elif count != 1.0:
            raise UserError(
                f"{found.text!r}: so often in that time, or so many periods? say 'at 1 Hz', or 'for {count:g} periods'"
            )
        self.made.quantities.append(self.quantity(every, "every", found.text))

    def _note_each(self, found: FilledSlot) -> None:
        """How long each part lasts, or how high each step is."""
        each = self.quantity(found.quantities[0], "for", found.text)
        if each.base == TIME and any(symbol.value == "per_cycle" for symbol in found.part):
            self.made.quantities.append(replace(each, role="", kind="period"))
        elif each.base == TIME:
            self.made.each = each
        else:
            self.made.increment = each

    def _note_delay(self, found: FilledSlot) -> None:
        """Raise UserError for a second one."""
        if self.made.delay is not None:
            raise IncompleteError(f"{self.made.delay.text} and {found.text} contradict one another: leave one out")
        role = "starting" if any(symbol.value == "starting" for symbol in found.part) else "for"
        self.made.delay = self.quantity(found.quantities[0], role, found.text)

    def _note_target(self, found: FilledSlot) -> None:
        self.output, self.noun, self.waiting = found.output, found.noun, True
        self.made.targets += [found.output] if found.output is not None else []

    def _note_all(self, found: FilledSlot) -> None:
        """All outputs that have a range. Raises UserError where that is one."""
        moving = [k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves]
        if len(moving) < 2:
            raise UserError(f"{found.text!r} of one? commands steer {self.vocabulary.steered}: say its name")
        self.made.targets += moving

    def _note_home_place(self, found: FilledSlot) -> None:
        self.made.verbs.append(Symbol("V", "home", found.text))
        self.made.targets += [found.output] if found.output is not None else []

    def _note_former(self, found: FilledSlot) -> None:
        """Where all was before, or one of several outputs that move."""
        if len([k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves]) > 1 and found.names:
            self.made.targets += [k for k in [self.named(found.names)] if k is not None]
        self.made.verbs.append(Symbol("V", "undo", found.text))

    def _note_verb(self, found: FilledSlot) -> None:
        self.made.verbs += [symbol for symbol in found.part if symbol.kind == "V"]

    def _note_direction(self, found: FilledSlot) -> None:
        """A side behind a place is of it, as in "to 20 degrees right". Raises UserError for "go to 2 m more"."""
        last = self.made.quantities[-1] if self.made.quantities else None
        ahead = self.part[self.part.index(found.part[-1]) + 1 :][:2]
        sided = found.part[-1].text in self.vocabulary.sides or [symbol.kind for symbol in ahead] == ["F", "u"]
        if last is not None and last.role == "to" and sided and last.value > 0.0:
            self.made.quantities[-1] = replace(last, value=last.value * found.part[-1].value)
            return
        if last is not None and last.role == "to":
            said = f"{last.text} {found.text}"
            raise UserError(f"{said!r}: to that value, or by it? say 'to' or 'by', and leave out {found.text!r}")
        way = next(symbol for symbol in found.part if symbol.kind in "U+")
        self.made.directions = [*(each for each in self.made.directions if each.kind == "U"), way]

    def _note_more(self, found: FilledSlot) -> None:
        """Up, but beside a direction, as in "further down", it says that one again."""
        if not self.made.directions:
            self._note_direction(found)

    def _note_pace(self, found: FilledSlot) -> None:
        if found.letters[0] == "c":
            self.made.smoothly = True
        else:
            self.made.paces.append(found.part[0].value)

    def _note_comparative(self, found: FilledSlot) -> None:
        step = LITTLE if "b" in found.letters else MUCH if "m" in found.letters else MORE
        sign = next(symbol.value for symbol in found.part if symbol.kind == "M")
        self.made.comparatives.append((1.0 + step * sign, found.text))

    def _note_as_fast(self, found: FilledSlot) -> None:
        """Raise UserError for a number that counts nothing."""
        if found.quantities and (found.quantities[0][1] is None or found.quantities[0][1].base != COUNT):
            raise UserError(f"{found.text!r}: how many times as fast? say 'three times as fast'")
        factor = found.quantities[0][0] if found.quantities else found.part[0].value
        slow = found.part[-1].value == "as_slow"
        self.made.comparatives.append((1.0 / factor if slow else factor, found.text))

    def _note_increment(self, found: FilledSlot) -> None:
        self.made.increment = self.quantity(found.quantities[0], "by", found.text)

    def _note_count_of_steps(self, found: FilledSlot) -> None:
        """With how long or how high each is."""
        self.made.count_of_steps = next(symbol.value for symbol in found.part if symbol.kind == "#")
        if found.quantities and is_time(found.quantities[0][1]):
            self._note_each(found)
        elif found.quantities:
            self._note_increment(found)

    def _note_whole_range(self, found: FilledSlot) -> None:
        self.made.whole_range = found.text

    def _note_together(self, found: FilledSlot) -> None:
        self.made.together = found.text

    def _note_to_name(self, found: FilledSlot) -> None:
        """A reference. Raises UserError for a noun beside it that is of something else."""
        if wrong := [symbol.text for symbol in found.part if symbol.kind == "K" and symbol.value != "value"]:
            raise UserError(f"{wrong[0]!r} has no meaning beside a reference's name: leave it out")
        self.made.names += [symbol.value for symbol in found.part if symbol.kind == "G"]

    def _note_object(self, found: FilledSlot) -> None:
        """Raise UserError for one that is all that is said."""
        if len(self.part) == 1:
            raise IncompleteError(f"{found.text!r} asks for nothing: say for example 'go to 1 {self.example}'")
        self.made.addressed = True

    def _note_share(self, found: FilledSlot) -> None:
        """A factor, or a percentage."""
        factor = next((symbol.value for symbol in found.part if symbol.kind == "S"), None)
        if factor is not None and factor < 1.0 and self.part[self.part.index(found.part[0]) - 1].kind == "+":
            raise UserError(f"another {found.text} of what? say how much, with its unit")
        value, unit = found.quantities[0] if found.quantities else (0.0, None)
        if factor is None and unit is not None and unit.base == COUNT and "N" in found.letters:
            factor = value  # "five times its present speed"
        if factor is None and (unit is None or unit.base != PERCENT):
            raise UserError(f"{found.text!r}: a share is in %, or half, a third, a quarter, twice")
        if any(symbol.value == "lowest" for symbol in found.part):
            raise UserError(f"{found.text!r}: that is a bound: say a value to go to")
        role = {"T": "to", "Y": "by", "W": "at", "I": "by"}.get(found.letters[0], "")
        word = next((symbol.text for symbol in found.part if symbol.kind == "S"), "")
        of = "range" if set("Xx") & set(found.letters) else "now" if "N" in found.letters else ""
        self.made.shares.append(
            Share(factor=0.01 * value if factor is None else factor, role=role, text=found.text, of=of, word=word)
        )
        self.made.targets += [found.output] if found.output is not None else []

    def _note_noun(self, found: FilledSlot) -> None:
        self.made.nouns.append(found.noun)

    def _note_here(self, found: FilledSlot) -> None:
        self.made.here = found.text

    def _note_bit(self, found: FilledSlot) -> None:
        self.made.bit = found.text

    def _note_sense(self, found: FilledSlot) -> None:
        """Raise UserError for a second one."""
        if self.made.sense is not None:
            raise IncompleteError(f"{self.made.sense.text} and {found.text} contradict one another: leave one out")
        self.made.sense = found.part[0]

    def _note_around_home(self, found: FilledSlot) -> None:
        self._note_value(found._replace(slot="around", quantities=[(0.0, None)]))

    def _note_from_home(self, found: FilledSlot) -> None:
        """Where a change is counted from, or where to go where this is all: "start from level"."""
        if len(found.part) == len([symbol for symbol in self.part if symbol.kind != ","]):
            self._note_home_place(found)
        else:
            self.made.from_home = found.text

    def _note_displacing(self, found: FilledSlot) -> None:
        if not self.made.quantities:  # "2 m, ramped over 5 s" leaves nothing open
            self.made.displacing = found.part[0]

    def _note_wish(self, found: FilledSlot) -> None:
        self.made.wish = True

    def _note_and(self, found: FilledSlot) -> None:
        """It says nothing by itself."""

    def _note_from_here(self, found: FilledSlot) -> None:
        """Every motion begins where the rig is, and a value before it is a change, as in "-35 rpm from where it is"."""
        if self.made.quantities and self.made.quantities[-1].role == "":
            self.made.quantities[-1] = replace(self.made.quantities[-1], role="by")
            self.made.verbs = self.made.verbs or [Symbol("V", "go", found.text)]

    _note_between = _note_range = _note_span = _note_ends
    _note_amplitude = _note_frequency = _note_period = _note_of_swing
    _note_later = _note_after = _note_delay

    # What these take.

    def begins(self) -> bool:
        """Whether no verb was said yet, or a stop, which takes no time."""
        if [symbol.value for symbol in self.made.verbs] == ["halt"]:
            return True
        return not (self.made.verbs or self.made.targets or self.made.directions or self.made.quantities)

    def paces(self, quantities: Sequence[tuple[float, Unit | None]]) -> bool:
        """Whether the last of some quantities says how fast or often, and one before it does not. Beside another value
        a unit of both kinds may say either, which is asked later.
        """
        own = [unit for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k)]
        rates = [unit.rate for unit in own]

        def is_pace(unit: Unit | None) -> bool:
            if unit is None or unit.base == FREQUENCY:
                return unit is not None
            return any(map(unit.alike, rates)) and (beside or not any(map(unit.alike, own)))

        beside = bool(self.made.quantities) and not self.made.targets
        *before, (_, last) = quantities or [(0.0, None)]
        return is_pace(last) and not any(unit is None or is_pace(unit) for _, unit in before)

    def quantity(
        self, said: tuple[float, Unit | None], role: str, text: str, *, kind: str = "", output: int | None = None
    ) -> Quantity:
        """One, of the output that was named with it or last; a time or a frequency is of none."""
        value, unit = said
        self.waiting = False
        several = value == 0.0 and output is None and len({*self.made.targets}) > 1 and not self.made.quantities
        taken = output if output is not None else None if several else self.output  # "speed and height to 0"
        kind = kind or ("" if unit is not None and unit.base in (TIME, FREQUENCY) else self.noun)
        return Quantity(value=value, unit=unit, role=role, text=text, kind=kind, output=taken)

    def named(self, nouns: Sequence[Symbol], *, needed: bool = True) -> int | None:
        """The output that nouns name together, None where there are none."""
        own = {symbol.value for symbol in nouns if symbol.kind == "O"}
        general = [symbol for symbol in nouns if symbol.kind == "K"]
        if not nouns or (not own and not needed):
            return None
        found = own or set(self.vocabulary.tracked)
        for symbol in general:
            found &= {*self.vocabulary.of_kind(symbol.value)}
        said = " ".join(symbol.text for symbol in nouns)
        if not found:
            raise UserError(f"{said!r} is nothing that commands steer here: they steer {self.vocabulary.steered}")
        if len(found) > 1 and any(symbol.value != "value" for symbol in general):
            listed = " or ".join(self.vocabulary.outputs[k].name for k in sorted(found))
            raise UserError(f"do you mean {listed}? say which instead of {said!r}")
        return found.pop() if len(found) == 1 else None


def is_time(unit: Unit | None) -> bool:
    """Whether a unit is one of time."""
    return unit is not None and unit.base == TIME
