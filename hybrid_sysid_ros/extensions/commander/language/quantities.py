"""Quantities: numbers in digits and words, and the units behind them."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from hybrid_sysid_ros.extensions.commander.language.lexicon import Lexicon, Symbol
from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary, meant
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, TIME, Unit, named
from hybrid_sysid_ros.support.errors import UserError

SMALLEST, LARGEST = 1e-12, 1e12
"""Of a number but 0: beyond lies nothing that a rig reaches, and arithmetic ends."""
THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
"""1.500 means 1500 where decimals have a comma, and 1,500 where they have a point."""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d+")
"""1.500,5 and 1,500.5 leave no doubt."""


class DoubtfulNumberError(UserError):
    """A number with one point or comma, which may part thousands."""


class Token(NamedTuple):
    """A piece of a text, and which it is: a number, a word, a mark ..."""

    kind: str
    text: str


class QuantityReader:
    """Tokens of a text, and how far they are read."""

    def __init__(self, tokens: list[Token], lexicon: Lexicon, vocabulary: Vocabulary) -> None:
        self.tokens, self.lexicon, self.vocabulary = tokens, lexicon, vocabulary
        self.words = [folded(token.text) if token.kind == "word" else "" for token in tokens]
        self.at = 0
        self.found: list[Symbol] = []

    def word(self) -> str:
        return self.words[self.at] if self.at < len(self.words) else ""

    def longest(self, phrases: object, skip: int = 0) -> int:
        return self.lexicon.longest(phrases, self.words[self.at + skip :])

    def quantity(self) -> Symbol | None:
        """A number in digits or words, with its unit; None where there is none."""
        start, sign = self.at, 0.0
        signs, numbers = self.lexicon.table["signs"], self.lexicon.table["numbers"]
        if self.word() in signs and self.longest(self.lexicon.verbs_of_numbers) > 1:
            return None  # "mais um pouco"
        if ("p", "plus_minus") in self.lexicon.meanings.get(tuple(self.words[self.at : self.at + 2]), ()):
            return None
        while self.word() in signs and self._number_follows():
            if sign:
                raise UserError("two signs before a number: write one")
            sign, self.at = signs[self.word()], self.at + 1
        token = self.tokens[self.at]
        if size := self.lexicon.table["sizes"].get(self.word()):  # "in hundreds"
            self.at += 1
            return Symbol("^", (float(size), self.unit_here()), token.text)
        if share := self.share_of_a_unit():  # before "one", which "one half" begins with
            value = share
        elif self.longest(self.lexicon.parts_of_one) or (
            self.longest(self.lexicon.verbs_of_numbers) and not self._led()
        ):
            return None  # "two thirds of its present value", "zero it"
        elif token.kind == "number":
            value = self.digits(token.text)
            if sign and value < 0.0:
                raise UserError(f"two signs before {abs(value):g}: write one")
            self.at += 1
            if value.is_integer() and numbers.get(self.word()) in (100, 1000) and self.word() not in ("cem", "cento"):
                value, self.at = value * numbers[self.word()], self.at + 1
        elif self.word() in numbers or self.longest(self._spelled()) or self._point_here(self.at):
            if self.word() in ("um", "uma", "one") and not sign and not self._one():
                return None
            value = self.spelled()
        elif self.article_for_one():
            value = 1.0
        else:
            self.at = start
            return None
        value = self.with_part(value) * (sign or 1.0)
        if not math.isfinite(value):
            raise UserError("a number without end: give one within the rig's limits")
        if value and not SMALLEST <= abs(value) <= LARGEST:
            raise UserError(f"{value:g} is nothing that a rig reaches: give a number from {SMALLEST:g} to {LARGEST:g}")
        if count := self.longest(self.lexicon.parts["steps"]):
            self.at += count
            return Symbol("#", value, " ".join(token.text for token in self.tokens[start : self.at]))
        value *= self.part_of()
        unit = self.unit_here()
        if unit is not None:
            value = self.with_part(value)
            value += self.smaller_time(unit)
            if unit.base not in (TIME, FREQUENCY, COUNT) and (count := self.longest(self.lexicon.parts["steps"])):
                self.at += count  # "in 2 m steps"
                return Symbol("^", (value, unit), " ".join(token.text for token in self.tokens[start : self.at]))
        return Symbol("Q", (value, unit), " ".join(token.text for token in self.tokens[start : self.at]))

    def part_of(self) -> float:
        """The tenths of "two tenths of a metre", which are taken; 1 where there are none."""
        share = self.lexicon.table["parts_of"].get(self.word())
        if share is None:
            return 1.0
        skip = 1 + (self.words[self.at + 1 : self.at + 2] in (["of"], ["de"]))
        skip += self.longest(self.lexicon.parts["articles"], skip=skip)
        if self.at + skip >= len(self.tokens):
            return 1.0
        if not self.longest(self.lexicon.units, skip=skip) and self._unit_at(self.at + skip) is None:
            return 1.0
        self.at += skip
        return float(share)

    def smaller_time(self, unit: Unit) -> float:
        """The seconds of "1 min 30 s" or "a minute and 30 seconds" in the unit before them; they are taken."""
        start = self.at
        if unit.base != TIME or unit.per or start >= len(self.tokens):
            return 0.0
        self.at += self.word() in ("and", "e")
        spoken = {*self.lexicon.table["numbers"]} - {"a", "um", "uma"}
        if self.at < len(self.tokens) and (self.tokens[self.at].kind == "number" or self.word() in spoken):
            more = self.quantity()
            if more is not None and more.kind == "Q" and more.value[1] is not None:
                value, own = more.value
                if (own.base, own.per) == (TIME, 0) and own.factor < unit.factor and value * own.factor < unit.factor:
                    return float(value * own.factor / unit.factor)
        self.at = start
        return 0.0

    def with_part(self, value: float) -> float:
        """With the half of "and a half", which is taken."""
        count = self.longest(self.lexicon.parts_more)
        more = self.lexicon.parts_more.get(tuple(self.words[self.at : self.at + count]), 0.0)
        self.at += count
        return value + math.copysign(more, value)

    def digits(self, text: str) -> float:
        decimal = self.lexicon.table["decimal"]
        if GROUPED.fullmatch(text):
            *groups, last = re.split("[.,]", text)
            return float(f"{''.join(groups)}.{last}")
        if decimal not in text and THOUSANDS.fullmatch(text):
            either = f"{re.sub('[.,]', decimal, text)} or {re.sub('[.,]', '', text)}"
            raise DoubtfulNumberError(f"{text}: {either}? say one of the two (diga um dos dois)")
        return float(text.replace(",", "."))

    def _spelled(self) -> set[tuple[str, ...]]:
        return {tuple(word.split()) for word in self.lexicon.table["numbers"]}

    def _one(self) -> bool:
        """Whether "one" is a number here: a unit or a decimal follows."""
        following = self.words[self.at + 1 : self.at + 2]
        if self.word() == "one" and self._led() and (not following or following[0] in ("", "more", "every", "each")):
            return True  # "add one"
        return bool(following) and (
            self.longest(self.lexicon.units, skip=1) > 0
            or tuple(following) in self.lexicon.parts["point"]
            or self.longest(self.lexicon.parts_more, skip=1) > 0
            or (self.at + 1 < len(self.tokens) and self._unit_at(self.at + 1) is not None)
            or following[0] in ("hundred", "thousand")
            or (self.word() == "one" and 0 <= self.lexicon.table["numbers"].get(following[0], -1) < 100)
        )

    def _led(self) -> bool:
        """Whether a direction or a preposition goes before, which leads to a number."""
        return bool(self.found) and self.found[-1].kind in "UTY+"

    def _number_follows(self, skip: int = 1) -> bool:
        k = self.at + skip
        if k >= len(self.tokens):
            return False
        spoken = {**self.lexicon.table["numbers"], **self.lexicon.table["signs"]}
        at, self.at = self.at, k
        share, self.at = self.share_of_a_unit() or self.article_for_one(), at
        if share or self.longest(self._spelled(), skip=skip):  # "half a metre", "a hundred"
            return True
        return self.tokens[k].kind == "number" or self.words[k] in spoken or self._point_here(k)

    def _point_here(self, k: int) -> bool:
        """Whether decimals in words begin here: "point five"."""
        following = self.words[k + 1 : k + 2]
        return (
            (self.words[k],) in self.lexicon.parts["point"]
            and bool(following)
            and following[0] in self.lexicon.table["numbers"]
        )

    def article_for_one(self) -> bool:
        """Whether "a metre" says one metre; the article is taken."""
        if (self.word(),) not in self.lexicon.parts["articles"] or self.word() not in ("a", "an", "um", "uma"):
            return False
        skip = 1 + self.longest(self.lexicon.parts["whole"], skip=1)
        if self.longest(self.lexicon.units, skip=skip) or (
            self.at + skip < len(self.tokens) and self._unit_at(self.at + skip) is not None
        ):
            self.at += skip
            return True
        return False

    def share_of_a_unit(self) -> float:
        """Half of "half a metre" or "a quarter turn", which is taken; 0 where there is none."""
        start, count = self.at, self.longest(self.lexicon.parts_of_one)
        if not count:
            return 0.0
        share = self.lexicon.parts_of_one[tuple(self.words[start : start + count])]
        count += self.longest(self.lexicon.meaning_first(("o", "of")), skip=count)
        self.at += count + self.longest(self.lexicon.parts["articles"], skip=count)
        if self.longest(self.lexicon.units) or (self.at < len(self.tokens) and self._unit_at(self.at) is not None):
            return share
        self.at = start
        return 0.0

    def spelled(self) -> float:
        """A number in words: "two hundred and fifty", "minus one point five"."""
        numbers = self.lexicon.table["numbers"]
        if (digits := self.digit_by_digit()) is not None:
            return digits
        hundreds, tens = (numbers.get(word, 0) for word in [*self.words[self.at : self.at + 2], ""][:2])
        timed = self.lexicon.units.get(tuple(self.words[self.at + 2 : self.at + 3])) in (
            "s",
            "min",
        )  # "one ten second ramp"
        if 0 < hundreds < 10 <= tens < 100 and not timed and self.lexicon.name == "en":  # "one twenty"
            self.at += 1
            return float(100 * hundreds) + self.spelled()
        total = group = 0.0
        while count := self.longest(self._spelled()):
            value = numbers[" ".join(self.words[self.at : self.at + count])]
            if value in (100.0, 1000.0) and self.words[self.at] not in ("cem", "cento"):
                group = max(group, 1.0) * value
            elif group and not self._fits(group, value):
                break
            else:
                group += value
            if group >= 1000.0:
                total, group = total + group, 0.0
            self.at += count
            ahead = self.words[self.at : self.at + 2]
            if (
                len(ahead) == 2
                and ahead[0] in ("and", "e")
                and ahead[1] in numbers
                and self._fits(total + group, numbers[ahead[1]])
            ):
                self.at += 1
        return total + group + self.behind_point()

    def digit_by_digit(self) -> float | None:
        """A number whose digits are said one by one, "four five nine zero", which is taken; None for any other."""
        numbers, said = self.lexicon.table["numbers"], list[int]()
        for word in self.words[self.at :]:
            if not 0 <= numbers.get(word, -1) < 10 or (word in ("um", "uma") and not said):
                break
            said.append(int(numbers[word]))
        if (
            len(said) < 2
            or said[0] == 0
            or self.words[self.at + len(said) :][:1] in (["hundred"], ["thousand"], ["mil"])
        ):
            return None
        self.at += len(said)
        value = float("".join(map(str, said)))
        return value + self.behind_point()

    def behind_point(self) -> float:
        """The decimals that a spoken point leads to, which are taken; 0 where there is none."""
        numbers, k = self.lexicon.table["numbers"], self.at + 1
        if not self.longest(self.lexicon.parts["point"]) or k >= len(self.tokens):
            return 0.0
        if self.words[k] not in numbers and self.tokens[k].kind != "number":
            return 0.0
        self.at += 1
        return self.decimals()

    def decimals(self) -> float:
        """Behind a point: digits one by one, or one number ("twenty five"). Raises UserError for others."""
        numbers, said = self.lexicon.table["numbers"], list[str]()
        while self.at < len(self.tokens) and (self.word() in numbers or self.tokens[self.at].kind == "number"):
            said.append(str(numbers[self.word()]) if self.word() in numbers else self.tokens[self.at].text)
            self.at += 1
            ahead = self.words[self.at : self.at + 2]
            tens = len(said) == 1 and len(said[0]) == 2 and said[0].endswith("0")
            if tens and len(ahead) == 2 and ahead[0] in ("and", "e") and 0 < numbers.get(ahead[1], 0) < 10:
                self.at += 1
            if tens and 0 < numbers.get(self.word(), 0) < 10:
                said, self.at = [said[0][0] + str(numbers[self.word()])], self.at + 1
        if not all(part.isdigit() for part in said) or (len(said) > 1 and any(len(part) > 1 for part in said)):
            raise UserError(f"decimals {' '.join(said)!r}: say them digit by digit")
        return float(f"0.{''.join(said)}")

    def _fits(self, before: float, value: float) -> bool:
        """Whether a number may come behind another one as a part of it."""
        return (
            (before % 100 == 0 and value < 100) or (before % 10 == 0 and before % 100 >= 20 and value < 10)
        ) and value > 0

    # Units.

    def unit_here(self) -> Unit | None:
        """The unit at this place, which is taken; None where there is none."""
        if self.at >= len(self.tokens):
            return None
        if count := self.longest(self.lexicon.units):
            symbol = self.lexicon.units[tuple(self.words[self.at : self.at + count])]
            self.at += count
            return self.known_unit(symbol)
        unit = self._unit_at(self.at)
        if unit is not None:
            self.at += 1
        elif self.tokens[self.at].kind == "unit":
            raise self.vocabulary.no_unit(self.tokens[self.at].text)
        return unit

    def _unit_at(self, k: int) -> Unit | None:
        token = self.tokens[k]
        if token.kind not in ("word", "unit"):
            return None
        symbol = token.text in self.vocabulary.units and (not token.text.islower() or token.text not in "aeo")
        if token.kind == "word" and (self.words[k],) in self.lexicon.meanings and not symbol:
            return None
        return self.unit(token.text)

    def unit(self, text: str) -> Unit | None:
        """The unit of a token, None where it is none."""
        if (own := self.vocabulary.units.get(text)) is not None:
            return own
        first, *below = text.split("/")
        symbol = self.lexicon.units.get((folded(first),))
        if symbol is None and below:
            candidates = meant(folded(first), frozenset(word for (word, *_) in self.lexicon.units))
            symbol = self.lexicon.units.get((candidates[0],)) if len(candidates) == 1 else None
        found = named("/".join([symbol or first, *below])) or self._small(text)
        often = found is not None and (found.base, found.per) == (COUNT, 1)  # "30 cycles per minute"
        return Unit(FREQUENCY, 0, found.factor) if found is not None and often else found

    def _small(self, text: str) -> Unit | None:
        """The unit of an output behind its prefix, where all is in small letters: "mv"."""
        own = {output.unit for output in self.vocabulary.outputs if output.unit.lower() == text[1:]}
        return named(text[0] + own.pop()) if len(own) == 1 else None

    def known_unit(self, symbol: str) -> Unit:
        unit = named(symbol)
        if unit is None:
            raise self.vocabulary.no_unit(symbol)
        return unit
