"""Clauses: the parts of a sentence, and what each says. A symbol that no pattern takes is refused by its words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.parts import sentence_parts
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.shared.units import COUNT, FREQUENCY, PERCENT, PLAIN, TIME, Unit
from hybrid_sysid_ros.support.errors import UserError

MOST = 20  # clauses
LITTLE, MORE, MUCH = 0.1, 0.2, 0.5
"""By which "a bit slower", "slower" and "much slower" change a speed or a frequency."""
PATTERNS: Sequence[tuple[str, str]] = (  # in letters of lexicon.ROLES and NOUNS; Q: a quantity, O: an output by name
    ("to_name", "[TW]?K?GK?"),
    ("condition", "Z|z[KO]?T?Q"),
    ("between", "B(?:[KO]o?)?Q[jT]Q"),
    ("range", "[Fo](?:[KO]o?)?QU?TQ"),
    ("span", "QU?TQ"),
    ("plus_minus", "[WY]?pQ"),
    ("around", "A(?:[KO]o?)?Q"),
    ("share", "[TWY]?(?:Q|S)o?[NXx](?:o?[KO])?"),
    ("limit", "Tx(?:o?[KO])?"),
    ("share", "[TWYI]?S(?:o?[KO](?:oO)?)?(?:o?J)?"),
    ("amplitude", "[jWo]?[ak]o?(?:oO)?J?[TYW]?Q|[WYo]?Qo?[ak]"),
    ("frequency", "[jWIo]?fo?J?[TYW]?Q|W?Qof"),
    ("period", "[jWo]?qo?J?[TYW]?Q|W?Qoq"),
    ("noun", "[afq](?:o[JO])?"),
    ("rate", "W[KO]o?Q"),
    ("at", "WQ(?:o[KO])?"),
    ("later", "I?QE"),
    ("to", "T(?:KoO|KO|OK|K|O)o?Q"),
    ("to", "TQ(?:o?[KO])?"),
    ("often", "QeQ"),
    ("by", "YQ(?:o?[KO])?"),
    ("for", "RQ"),
    ("in", "IQ"),
    ("in_or_to", "iQ"),
    ("for_or_by", "rQ"),
    ("within", "LQ"),
    ("after", "DQ"),
    ("every", "eQ"),
    ("from", "F(?:[KO]o?)?Q"),
    ("target", "o?(?:KoO|KO|OK|K|O)(?:o?J)?"),
    ("plain", "o?Q(?:o?[KO])?"),
    ("comparative", "b?m?M"),
    ("bit", "b"),
    ("direction", "U(?:o?J)?"),
    ("home_place", "[TWo]?u"),
    ("verb", "o?V(?:o?J)*"),
    ("pace", "[Cc]"),
    ("here", "[WA]?H"),
    ("object", "J"),
    ("wish", "w"),
    ("displacing", "y"),
    ("and", "(?!^)j(?!$)"),
)
"""What symbols in a row come to; the first that fits is taken."""
ENDS = ("between", "range", "span")
"""Slots of two values."""
_COMPILED = tuple((slot, re.compile(pattern)) for slot, pattern in PATTERNS)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number with its unit, and what it is for."""

    value: float
    unit: Unit | None
    role: str
    text: str
    kind: str = ""
    """"amplitude", "peak_to_peak", "speed", ... where a noun said so."""
    output: int | None = None
    """Which was named with it."""

    @property
    def said(self) -> float:
        """In the base of its unit."""
        return self.value * (self.unit or PLAIN).factor

    @property
    def base(self) -> str:
        return self.unit.base if self.unit is not None else ""


@dataclass(frozen=True)
class Share:
    """A factor of the present value, of the range, or of what was not said."""

    factor: float
    of: str
    """"now", "range" or ""."""
    role: str
    text: str
    word: str
    """That says the factor."""


@dataclass(kw_only=True)
class Clause:
    """What one part of a sentence says."""

    then: bool = False
    """Whether it begins with the word."""
    verbs: list[Symbol] = field(default_factory=list)
    quantities: list[Quantity] = field(default_factory=list)
    shares: list[Share] = field(default_factory=list)
    paces: list[str] = field(default_factory=list)
    directions: list[Symbol] = field(default_factory=list)
    comparatives: list[tuple[float, str]] = field(default_factory=list)
    """Factors, and what was said."""
    targets: list[int] = field(default_factory=list)
    nouns: list[str] = field(default_factory=list)
    """"amplitude", "frequency" or "period" that stand alone."""
    names: list[str] = field(default_factory=list)
    delay: Quantity | None = None
    condition: tuple[str, Quantity | None] | None = None
    """"once" or "until", and which value is waited for; None: that nothing moves any more."""
    here: str = ""
    bit: str = ""
    smoothly: bool = False
    displacing: Symbol | None = None
    """A verb of moving, which leaves open whether a value is a place or a change; "change" does with a speed, too."""
    wish: bool = False
    """Whether "I want" or "give me" was said, which asks for the value behind it."""

    @property
    def empty(self) -> bool:
        return not (
            self.verbs or self.quantities or self.shares or self.paces or self.directions or self.comparatives
            or self.targets or self.names or self.delay or self.condition or self.here or self.nouns
        )  # fmt: skip


def clauses(found: Sequence[Symbol], vocabulary: Vocabulary) -> list[Clause]:
    """The clauses of a sentence. Raises UserError for what can't be read, in a line that says what to write instead."""
    made = [_Matcher(part, vocabulary).clause() for part in sentence_parts(found)]
    made = [clause for clause in made if not clause.empty]
    if not made:
        raise UserError("this asks for nothing: say for example 'go to', 'hold', 'swing between', 'home' or 'stop'")
    if len(made) > MOST:
        raise UserError(f"{len(made)} parts: a command has {MOST} at most; for more, follow a file")
    return made


class _Matcher:
    """Fits patterns to the symbols of one clause."""

    def __init__(self, part: Sequence[Symbol], vocabulary: Vocabulary) -> None:
        then = part[0].value == "then"
        self.part, self.vocabulary = part[then:], vocabulary
        self.made = Clause(then=then)
        self.output: int | None = None
        """That was named last."""
        self.waiting = False
        """Whether it has no value yet."""
        self.noun = ""

    def clause(self) -> Clause:
        letters = "".join(symbol.kind for symbol in self.part)
        at = 0
        while at < len(letters):
            for slot, pattern in _COMPILED:
                match = pattern.match(letters, at)
                if match and match.end() > at and not (slot == "object" and at):
                    end = self.end(slot, match)
                    self.slot(slot, self.part[at:end], letters[at:end])
                    at = end
                    break
            else:
                raise UserError(self.without_meaning(at))
        return self.made

    def end(self, slot: str, match: re.Match[str]) -> int:
        """Where a match ends: a name behind a value is not its own where another one stands before it ("height 300 m,
        speed 10 m/s"). Raises UserError for a condition that would have to last.
        """
        if slot == "condition" and match.string[match.end() :][:2] in ("RQ", "rQ"):
            raise UserError("how long a condition lasts is not watched: say 'once it is still, wait 5 s, then go to 0'")
        if not self.waiting or "Q" not in match[0] or match[0][-1] not in "KO":
            return match.end()
        return match.start() + match[0].index("Q") + 1

    def without_meaning(self, at: int) -> str:
        symbol = self.part[at]
        before = " ".join(dict.fromkeys(each.text for each in self.part[max(0, at - 2) : at]))
        where = f"after {before!r}" if before else "at the beginning"
        return f"{symbol.text!r} has no meaning {where}: leave it out, or say for example 'go to 1 {self.example}'"

    @property
    def example(self) -> str:
        return self.vocabulary.outputs[self.vocabulary.tracked[0]].unit if self.vocabulary.tracked else ""

    def slot(self, slot: str, part: Sequence[Symbol], letters: str) -> None:
        """Note what a pattern has found."""
        made, text = self.made, " ".join(symbol.text for symbol in part)
        quantities = [symbol.value for symbol in part if symbol.kind == "Q"]
        output = self.named([symbol for symbol in part if symbol.kind in "KO"], needed=slot not in ("rate",))
        noun = next((str(symbol.value) for symbol in part if symbol.kind in "Kakfq"), "")
        if slot == "in_or_to":  # Portuguese "em": "em 2 s", "aumente em 2 m"
            slot = "in" if self.is_time(quantities[0][1]) else "by" if made.directions else "to"
        if any(symbol.value == "to_or_at" for symbol in part) and self.paces(quantities):  # Portuguese "a": "a 2 Hz"
            made.quantities += [self.quantity(said, "", text) for said in quantities[:-1]]
            slot, quantities = "rate", quantities[-1:]
        if slot == "for_or_by":  # Portuguese "por": "por 2 s", "aumente por 2 m"
            slot = "for" if quantities[0][1] is None or quantities[0][1].base in (TIME, COUNT) else "by"
        if slot == "condition":
            reached = self.quantity(quantities[0], "to", text, output=output) if quantities else None
            made.condition = (part[0].value, reached)
        elif slot in ENDS:
            made.quantities += [self.quantity(said, slot, text, output=output) for said in quantities]
        elif slot == "share":
            self.share(part, letters, text)
        elif slot == "limit":
            made.shares.append(Share(factor=1.0, role="to", text=text, of="range", word=""))
            made.targets += [output] if output is not None else []
        elif slot in ("amplitude", "frequency", "period"):
            role = "to" if "T" in letters else "by" if "Y" in letters else ""
            made.quantities.append(self.quantity(quantities[0], role, text, kind=noun or slot))
        elif slot == "often":
            self.often(quantities, text)
        elif slot == "noun":
            made.nouns.append(noun)
        elif slot in ("later", "after") or (slot == "in" and self.begins() and self.is_time(quantities[0][1])):
            if made.delay is not None:
                raise UserError(f"{made.delay.text} and {text} contradict one another: leave one out")
            made.delay = self.quantity(quantities[0], "for", text)
        elif slot == "target":
            self.output, self.noun, self.waiting = output, noun, True
            made.targets += [output] if output is not None else []
        elif quantities:
            role = {"plain": "", "rate": "at"}.get(slot, slot)
            made.quantities.append(self.quantity(quantities[0], role, text, kind=noun, output=output))
        elif slot == "home_place":
            made.verbs.append(Symbol("V", "home", text))
        elif slot == "verb":
            made.verbs += [symbol for symbol in part if symbol.kind == "V"]
        elif slot == "direction":
            if made.quantities and made.quantities[-1].role == "to":  # "go to 2 m more"
                said = f"{made.quantities[-1].text} {text}"
                raise UserError(f"{said!r}: to that value, or by it? say 'to' or 'by', and leave out {text!r}")
            made.directions.append(part[0])
        elif slot == "pace":
            if letters == "c":
                made.smoothly = True
            else:
                made.paces.append(part[0].value)
        elif slot == "comparative":
            step = LITTLE if "b" in letters else MUCH if "m" in letters else MORE
            made.comparatives.append((1.0 + step * part[-1].value, text))
        elif slot == "to_name":
            if wrong := [symbol.text for symbol in part if symbol.kind == "K" and symbol.value != "value"]:
                raise UserError(f"{wrong[0]!r} has no meaning beside a reference's name: leave it out")
            made.names += [symbol.value for symbol in part if symbol.kind == "G"]
        elif slot == "here":
            made.here = text
        elif slot == "bit":
            made.bit = text
        elif slot == "displacing":
            made.displacing = part[0]
        elif slot == "wish":
            made.wish = True
        elif slot == "object" and self.made.empty and len(self.part) == 1:
            raise UserError(f"{text!r} asks for nothing: say for example 'go to 1 {self.example}'")

    def often(self, quantities: Sequence[tuple[float, Unit | None]], text: str) -> None:
        """As in "one cycle every 4 s". Raises UserError for a count that could be that of all periods."""
        (count, unit), every = quantities
        if unit is None or unit.base != COUNT:
            self.made.quantities.append(self.quantity(quantities[0], "", text))
        elif count != 1.0:
            raise UserError(
                f"{text!r}: so often in that time, or so many periods? say 'at 1 Hz', or 'for {count:g} periods'"
            )
        self.made.quantities.append(self.quantity(every, "every", text))

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

    def is_time(self, unit: Unit | None) -> bool:
        return unit is not None and unit.base == TIME

    def quantity(
        self, said: tuple[float, Unit | None], role: str, text: str, *, kind: str = "", output: int | None = None
    ) -> Quantity:
        """One, of the output that was named with it or last."""
        value, unit = said
        self.waiting = False
        taken = output if output is not None else self.output
        return Quantity(value=value, unit=unit, role=role, text=text, kind=kind or self.noun, output=taken)

    def share(self, part: Sequence[Symbol], letters: str, text: str) -> None:
        """A factor, or a percentage."""
        factor = next((symbol.value for symbol in part if symbol.kind == "S"), None)
        value, unit = next((symbol.value for symbol in part if symbol.kind == "Q"), (0.0, None))
        if factor is None and (unit is None or unit.base != PERCENT):
            raise UserError(f"{text!r}: a share is in %, or half, a third, a quarter, twice")
        role = {"T": "to", "Y": "by", "W": "at", "I": "by"}.get(letters[0], "")
        word = next((symbol.text for symbol in part if symbol.kind == "S"), "")
        of = "now" if "N" in letters else "range" if set("Xx") & set(letters) else ""
        self.made.shares.append(
            Share(factor=0.01 * value if factor is None else factor, role=role, text=text, of=of, word=word)
        )
        output = self.named([symbol for symbol in part if symbol.kind in "KO"])
        self.made.targets += [output] if output is not None else []

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
