"""Sentences: a text cut into clauses of words, quantities and names, typing slips mended; nothing is passed over."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from hybrid_sysid_ros.extensions.commander.language import vocabulary as words
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import PLAIN, Unit, named
from hybrid_sysid_ros.support.errors import UserError

LONGEST = 300  # characters of a sentence
MOST = 20  # clauses
SMALLEST, LARGEST = 1e-12, 1e12
"""Of a number but 0: beyond lies nothing that a rig reaches, and arithmetic ends."""
TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>[+-]?(?:\d+(?:\.\d+)?|\.\d+)(?:[eE][+-]?\d+)?)
    | (?P<sign>\+/?-|±)
    | (?P<path>"[^"]{1,200}"|'[^']{1,200}'|[\w~-][\w./~-]*\.(?i:csv|txt|jpe?g|png)\b)
    | (?P<unit>(?:%|°)(?:/(?:s|min)(?:\^2)?)?|[A-Za-zµ]+(?:/(?:s|min|h|sec|second)(?:\^2|²)?\b))
    | (?P<word>[A-Za-zµ_][A-Za-zµ_0-9]*(?:'[a-z]+)?)
    | (?P<mark>[,;.!?:\n])
    )""",
    re.VERBOSE,
)
PHRASES = (
    (re.compile(r"\b(?:and\s+)?(?:after\s+(?:that|this)|thereafter)\b", re.I), " then "),
    (re.compile(r"\bback\s+(?=to\b|home\b)", re.I), " "),
    (re.compile(r"\bback\s+and\s+forth\b", re.I), " swing "),
    (re.compile(r"\b(as)\s+(fast|quickly|slowly)\s+as\s+possible\b", re.I), r"\2"),
    (re.compile(r"\bper\s+sec(?:ond)?s?\b", re.I), " /s "),
    (re.compile(r"\bper\s+min(?:ute)?s?\b", re.I), " /min "),
    (re.compile(r"\s+/\s*(s|min)\b"), r"/\1"),
    (re.compile(r"\bper\s+cent\b", re.I), "percent"),
    (re.compile(r"(?<=\d)\s*(?:N m|newton[ -]?met(?:er|re)s?)\b"), " Nm"),
)
"""What is written in several words."""
LOOKALIKES = str.maketrans({"\u2212": "-", "\u2013": "-", "\u2019": "'", "\u00ba": "°", "\u03bc": "µ", "\t": " "})
"""Minus, en dash, apostrophe, ordinal and Greek mu, as editors and phones write them."""


@dataclass(frozen=True)
class Quantity:
    """A number with its unit, and the word before it that says what it is for ("" for none)."""

    value: float
    unit: Unit | None
    role: str
    output: int | None = None
    """Which was named before it."""
    rate: bool = False
    """Whether a word for a speed was before it."""

    @property
    def said(self) -> float:
        """In the base of its unit."""
        return self.value * (self.unit or PLAIN).factor


@dataclass(kw_only=True)
class Clause:
    """What one part of a sentence says."""

    verbs: list[str] = field(default_factory=list)
    quantities: list[Quantity] = field(default_factory=list)
    paces: list[str] = field(default_factory=list)
    directions: list[float] = field(default_factory=list)
    outputs: list[int] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    """Of files and of the rig's own references."""

    @property
    def empty(self) -> bool:
        return not (self.verbs or self.quantities or self.paces or self.directions or self.names)


def clauses(text: str, vocabulary: Vocabulary) -> list[Clause]:
    """The clauses of a sentence. Raises UserError for what can't be read, in a line that says what to write instead."""
    if not text.strip():
        raise UserError("empty: say for example 'hold 0'")
    if len(text) > LONGEST:
        raise UserError(f"{len(text)} characters: a command has {LONGEST} at most; for more, follow a file")
    text = text.translate(LOOKALIKES)
    for phrase, other in PHRASES:
        text = phrase.sub(other, text)
    reader = _Reader(vocabulary)
    for kind, token in _tokens(text):
        reader.take(kind, token)
    found = [clause for clause in reader.found if not clause.empty]
    if not found:
        raise UserError(f"{text.strip()[:40]!r} asks for nothing: begin with one of {_listed(words.VERBS)}")
    if len(found) > MOST:
        raise UserError(f"{len(found)} parts: a command has {MOST} at most; for more, follow a file")
    return found


def _tokens(text: str) -> Iterator[tuple[str, str]]:
    """Kinds and texts of what a sentence is made of."""
    position, end = 0, len(text.rstrip())
    while position < end:
        match = TOKEN.match(text, position)
        if match is None or match.end() == position:
            wrong = text[position:].lstrip()[:1]
            raise UserError(f"{wrong!r} means nothing in a command: words, numbers and units only")
        position = match.end()
        kind = str(match.lastgroup)
        if kind == "mark" and match[kind] == "," and re.match(r"\d", text[position:]) and text[position - 2].isdigit():
            raise UserError("a comma between digits: write decimals with a point, as in 1.5")
        yield kind, match[kind]


class _Reader:
    """Takes tokens one after the other."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self.vocabulary = vocabulary
        self.found = [Clause()]
        self.role = ""
        self.sign = 0.0
        """Of a number to come, in words; 0 where nothing was said."""
        self.joined = False
        """Whether the last word was "and"."""
        self.open = False
        """Whether the last quantity may still get a unit."""
        self.rate = False
        """Whether a speed was spoken of, and no number yet."""

    @property
    def clause(self) -> Clause:
        return self.found[-1]

    def take(self, kind: str, token: str) -> None:
        """One more token."""
        if kind == "number":
            self.number(float(token))
        elif kind == "sign":
            self.role, self.open = words.PLUS_MINUS, False
        elif kind == "path":
            self.clause.names.append(token.strip("\"'"))
        elif kind == "mark":
            if token in ";.!?\n":
                self.end()
        elif kind == "unit" or (self.open and self.unit_of(token) is not None):
            self.unit(token)
        else:
            self.word(token)

    def end(self) -> None:
        """The clause is over."""
        if not self.clause.empty:
            self.found.append(Clause())
        self.role, self.sign, self.open, self.joined, self.rate = "", 0.0, False, False, False

    def number(self, value: float) -> None:
        """A quantity, whose unit may follow."""
        if not math.isfinite(value):
            raise UserError("a number without end: give one within the rig's limits")
        if value and not SMALLEST <= abs(value) <= LARGEST:
            raise UserError(f"{value:g} is nothing that a rig reaches: give a number from {SMALLEST:g} to {LARGEST:g}")
        if self.sign and value < 0.0:
            raise UserError(f"two signs before {abs(value):g}: write one")
        output = self.clause.outputs[-1] if self.clause.outputs else None
        self.clause.quantities.append(Quantity((self.sign or 1.0) * value, None, self.role, output, self.rate))
        self.sign, self.open, self.joined, self.rate = 0.0, True, False, False

    def unit_of(self, token: str) -> Unit | None:
        """The unit of a token; a word that has another meaning after a number is none."""
        own = self.vocabulary.units.get(token)
        return own if own is not None else named(token)

    def unit(self, token: str) -> None:
        """The unit of the last number."""
        unit, last = self.unit_of(token), self.clause.quantities[-1] if self.clause.quantities else None
        if unit is None:
            base, _, below = token.partition("/")
            meant = [word for word in self.vocabulary.meant(base.lower()) if named(word)]
            unit = named("/".join(filter(None, (meant[0], below)))) if len(meant) == 1 else None
        if unit is None:
            raise self.no_unit(token)
        if last is None or not self.open:
            raise UserError(f"{token!r} has no number before it: write for example '3 {token}'")
        self.clause.quantities[-1] = replace(last, unit=unit)
        self.open = False

    def no_unit(self, token: str) -> UserError:
        """The refusal of a word in a unit's place."""
        return UserError(f"no unit {token[:40]!r}: known are {self.listed_units()}, s, Hz, %")

    def listed_units(self) -> str:
        """The units of this rig's outputs."""
        tracked = (self.vocabulary.outputs[k] for k in self.vocabulary.tracked)
        found = [text for output in tracked for text in (output.unit, self.vocabulary.si(output)) if text]
        return ", ".join(dict.fromkeys([*found, *(["deg"] if "rad" in found else [])]))

    def word(self, token: str) -> None:
        """A word, mended where it was written with a slip."""
        word = token.lower()
        asked = words.FOLLOW in self.clause.verbs or word not in self.vocabulary.names
        if word in self.vocabulary.inputs and (word not in words.VERBS or (self.clause.verbs and not self.joined)):
            tracked = ", ".join(self.vocabulary.outputs[k].name for k in self.vocabulary.tracked) or "no output"
            raise UserError(f"{token} is an input, which the controller sets: commands ask for {tracked}")
        if token in self.vocabulary.rig.references and asked:
            self.clause.names.append(token)
        elif self.vocabulary.knows(word):
            self.known(word)
        elif self.open and (meant := [each for each in self.vocabulary.meant(word) if named(each)]):
            self.unit(meant[0])
        else:
            meant = list(self.vocabulary.meant(word))
            meanings = {self.meaning(each) for each in meant}
            if words.STOP in {words.VERBS.get(each) for each in meant}:
                self.known(words.STOP)
            elif len(meanings) == 1:
                self.known(meant[0])
            elif self.open and not meant:
                raise self.no_unit(token)
            else:
                hint = (
                    f"did you mean {' or '.join(meant[:3])}?" if meant else f"begin with one of {_listed(words.VERBS)}"
                )
                raise UserError(f"unknown word {token[:40]!r}: {hint}")

    def meaning(self, word: str) -> object:
        """What two words have in common that are the same."""
        for table in (words.VERBS, words.ROLES, words.PACES, words.DIRECTIONS, words.NUMBERS):
            if word in table:
                return table[word]
        return "" if word in self.vocabulary.fillers else word

    def known(self, word: str) -> None:
        """A word that means something."""
        if word in words.REFUSED:
            raise UserError(f"{word!r}: {words.REFUSED[word]}")
        if self.joined and word in words.VERBS and self.clause.verbs:
            self.end()
        self.joined = word == words.AND
        if word in words.THEN:
            self.end()
        elif word in self.vocabulary.names:
            self.clause.outputs.append(self.vocabulary.names[word])
        elif word in words.NUMBERS:
            self.number(words.NUMBERS[word])
        elif word in words.SIGNS:
            if self.sign:
                raise UserError("two signs before a number: write one")
            self.sign = words.SIGNS[word]
        elif word in words.PACES:
            self.clause.paces.append(words.PACES[word])
        elif word in words.VERBS or word in words.DIRECTIONS:
            self.clause.verbs += [words.VERBS[word]] if word in words.VERBS else []
            self.clause.directions += [words.DIRECTIONS[word]] if word in words.DIRECTIONS else []
            self.role = ""
        elif word in words.ROLES:
            if word != words.AND or self.role != words.BETWEEN:
                self.role = "" if word == words.AND else words.ROLES[word]
        elif word not in self.vocabulary.fillers:  # a unit's name
            self.unit(word)
        elif word in words.RATES:
            self.rate = True
        self.open = False if word not in words.NUMBERS else self.open


def _listed(table: object) -> str:
    return ", ".join(dict.fromkeys(words.VERBS.values())) if table is words.VERBS else ""
