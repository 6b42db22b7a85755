"""Bare numbers: a number without a unit in the place of a value has the unit that was said of its output, or else
the one in which the rig's file shows it, which the reply says before anything moves.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.lexicon import Lexicon, Symbol
from hybrid_sysid_ros.extensions.commander.language.parts import SWUNG
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import FREQUENCY, TIME, Unit

NO_VALUE_AFTER = re.compile(r"(?:[RrLDe#<Ii]A?|[fq]o?[TYW]?|Qe)$")
"""Letters before a number that could be a time, a count or a frequency."""
TIMED = re.compile("[RrL]A?$")
"""Letters before what can only be a time, where one was said before: "for 8 s, ... for another 8"."""
SECOND = Unit(TIME)
WAITS_FOR = re.compile("VR$")
STAYS = ("hold", "wait", "still")
"""Verbs behind which "for 5" says how long."""
TIMELESS = frozenset({"hold", "wait", "still", "repeat", "follow", "halt", "undo", "chirp"})
"""Verbs behind which a number could as well be a time, a count or a frequency."""


class BareNumbers:
    """Of one sentence."""

    def __init__(self, found: Sequence[Symbol], vocabulary: Vocabulary, lexicon: Lexicon) -> None:
        self.found, self.vocabulary, self.lexicon = list(found), vocabulary, lexicon
        self.given = tuple(found)
        self.letters = "".join(symbol.kind for symbol in found)
        self.moving = [k for k in vocabulary.tracked if vocabulary.outputs[k].moves]
        self.output = self.moving[0] if len(self.moving) == 1 else None
        """Of which a value at this place is; None where that is not certain."""
        self.time: Unit | None = None
        """That was said last."""

    def with_units(self) -> list[Symbol]:
        """The symbols, with units where these leave no doubt."""
        for k, symbol in enumerate(self.found):
            if symbol.kind == "Q" and symbol.value[1] is not None and symbol.value[1].base == TIME:
                self.time = symbol.value[1]
            if len(self.moving) > 1:
                self.follow(k, symbol)
            if symbol.kind not in "Q^" or symbol.value[1] is not None:
                continue
            if not symbol.value[0] and not self.one_spoken_of(k):
                continue
            waits = self.lasts(k)
            unit = self.time  # for "..., for another 8"
            if waits:
                unit = self.time or SECOND
            elif not TIMED.search(self.letters[:k]):
                unit = self.unit(k)
            if unit is not None and (symbol.kind == "^" or waits or unit is self.time or self.is_value(k)):
                self.found[k] = symbol._replace(value=(symbol.value[0], unit))
        return self.found

    def follow(self, k: int, symbol: Symbol) -> None:
        """Which output is spoken of behind a symbol: the one named, moved by the verb, or measured in the unit."""
        if symbol.kind == "O":
            self.output = symbol.value if symbol.value in self.moving else None
        elif symbol.kind == "K":
            self.output = self.only(self.vocabulary.of_kind(symbol.value)) if symbol.value != "value" else self.output
        elif symbol.kind == "d" or (symbol.kind == "U" and symbol.text.rpartition(" ")[2] in self.lexicon.plain_ways):
            moved = self.only(self.vocabulary.of_kind("height" if symbol.kind == "U" else "speed"))
            if moved is not None and (symbol.kind == "d" or (self.output is None and self.beyond_others(k, moved))):
                self.output = moved
        elif symbol.kind == "V" and symbol.value not in TIMELESS and (base := self.moved_by(symbol)):
            self.output = self.only([each for each in self.moving if self.vocabulary.units_of(each)[1].base == base])
        elif symbol.kind == "Q" and (own := self.measured(symbol)) is not None:
            self.output = own
        elif symbol.kind == "Q" and self.letters[k + 1 : k + 2] == "M":  # "5 faster"
            self.output = self.only(self.vocabulary.of_kind("speed"))
        elif symbol.kind == "Q" and (behind := re.match("o?O", self.letters[k + 1 :])):
            self.output = self.found[k + behind.end()].value  # "100 in height"

    def beyond_others(self, k: int, output: int) -> bool:
        """Whether the number beside a direction is out of reach for all other outputs."""
        near = [self.found[j] for j in (k + 1, k + 2, k - 1) if 0 <= j < len(self.found)]
        value = next((abs(each.value[0]) for each in near if each.kind == "Q" and each.value[1] is None), 0.0)
        spans = (self.vocabulary.outputs[j] for j in self.moving if j != output)
        return all(value > shown.high - shown.low for shown in spans)

    def lasts(self, k: int) -> bool:
        """Whether a number can only be a time: behind "wait", "hold for", and where a time was said before, behind
        "over" of what says where to go ("down to 0 over 10") and behind one more "hold" ("fica mais 30").
        """
        before = self.found[max(0, k - 2) : k]
        verb = before[-1].value if before else ""
        if verb == "wait" or (WAITS_FOR.search(self.letters[:k]) and before[0].value in STAYS):
            return True
        begin = self.letters.rfind(";", 0, k) + 1
        said = self.letters[begin:k]
        over = verb in ("over", "within") and re.search("TO?Q", said) is not None
        if re.search("T[KO]?Q.*I$|[VUO].*TQi$", said) and not re.match("[qfo]", self.letters[k + 1 :]):
            return True  # "to 30 rpm in 5"
        more = verb in STAYS and self.found[k].text.partition(" ")[0] in self.lexicon.table["signs"]
        return self.time is not None and (over or more)

    def one_spoken_of(self, k: int) -> bool:
        """Whether a 0 is of the one output that was spoken of before, in this sentence."""
        if len(self.moving) == 1:
            return self.said(k) is not None
        before = self.found[:k]
        named = {symbol.value for symbol in before if symbol.kind == "O"} | {self.measured(symbol) for symbol in before}
        return named - {None} == {self.output} and not any(each.kind == "l" for each in self.found)

    def moved_by(self, verb: Symbol) -> str:
        """The base of the unit in which a verb's motion is measured, as that of turning; "" where it says none."""
        moved = self.lexicon.table["moved"]
        return next((base for base, verbs in moved.items() if verb.text.split()[0] in verbs), "")

    def only(self, outputs: Sequence[int]) -> int | None:
        moving = [k for k in outputs if k in self.moving]
        return moving[0] if len(moving) == 1 else None

    def measured(self, symbol: Symbol) -> int | None:
        """The output that is measured in a quantity's unit, where that is one."""
        unit = symbol.value[1] if symbol.kind == "Q" else None
        alike = [k for k in self.moving if unit and any(map(unit.alike, self.vocabulary.units_of(k)))]
        return alike[0] if len(alike) == 1 else None

    def unit(self, k: int) -> Unit | None:
        """That of a bare number: what was said of the output last, or is next, or else what it is shown in."""
        if self.output is None:
            return None
        return self.said(k) or self.vocabulary.units_of(self.output)[0]

    def said(self, k: int) -> Unit | None:
        """The unit that is said of the output nearest before a place, or else behind it."""
        assert self.output is not None
        own = self.vocabulary.units_of(self.output)
        units = [
            symbol.value[1]
            if any(map(symbol.value[1].alike, own))
            else next((unit for unit in own if unit.rate == symbol.value[1]), None)
            for symbol in (*reversed(self.found[:k]), *self.found[k:])
            if symbol.kind in "Q^" and symbol.value[1] is not None
        ]
        return next(filter(None, units), None)

    def is_value(self, k: int) -> bool:
        """Whether a number may be a value: it is not in the place of a time, a count, a share or a frequency, and
        no verb that could take one of these stands right before it.
        """
        begin = self.letters.rfind(";", 0, k) + 1
        part = [symbol for symbol in self.found[begin:k] if symbol.kind not in "JH"]
        before, after = "".join(symbol.kind for symbol in part), self.letters[k + 1 :]
        verbs = {symbol.value for symbol in part if symbol.kind == "V"}
        if re.match(r"[E#fqNx]|e(?!Q)|o?[fq]", after) or NO_VALUE_AFTER.search(before):
            settled = "O" in before or "hold" in verbs
            return before.endswith("i") and ("U" in before or (settled and bool(verbs) and "Q" not in before))
        if self.paired(k):
            return False
        if before.endswith("W"):
            return not verbs & SWUNG and "Q" not in before[max(before.rfind("V"), before.rfind(",")) + 1 :]
        if before.endswith("V") and not re.match("R", after):  # "leave it running at 3 for a minute"
            return not verbs & TIMELESS and (
                before[-2:-1] != "y" or re.match("[UMd]", after) is not None or self.place() or self.said(k) is not None
            )
        return bool(before or begin or after)

    def place(self) -> bool:
        """Whether the output is one whose values are places, which a verb of moving goes to or by."""
        return self.output is not None and self.vocabulary.units_of(self.output)[1].per == 0

    def paired(self, k: int) -> bool:
        """Whether it is one end of a pair whose other one is a frequency."""
        near = [
            self.given[j]
            for j in (k - 3, k - 2, k + 2, k + 3)
            if 0 <= j < len(self.found) and set(self.letters[min(j, k) + 1 : max(j, k)]) <= set("TjU")
        ]
        return any(symbol.kind == "Q" and symbol.value[1] and symbol.value[1].base == FREQUENCY for symbol in near)
