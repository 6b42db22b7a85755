"""Lexicons: what the phrases of a language mean in a command. The grammar is one for all languages."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.support.structured import read_mapping

LANGUAGES = ("en", "pt")
LONGEST_PHRASE = 10
"""Words."""
VERBS = (
    "go", "hold", "still", "step", "ramp", "swing", "square", "toggle", "triangle", "chirp", "wait", "follow", "look",
    "repeat", "undo", "home", "halt", "stairs",
)  # fmt: skip
ROLES = {
    "to": "T", "from": "F", "between": "B", "by": "Y", "around": "A", "at": "W", "for": "R", "in": "I", "over": "I",
    "within": "L", "after": "D", "starting": "D",
    "later": "E", "every": "e", "per_cycle": "e", "and": "j", "plus_minus": "p", "of": "o",
    "object": "J",
    "here": "H", "in_or_to": "i", "for_or_by": "r", "bit": "b", "much": "m", "present": "N", "range": "X",
    "highest": "x", "lowest": "x", "smoothly": "c", "want": "w", "to_or_at": "T", "forwards": "d", "backwards": "d",
    "as_fast": "g", "as_slow": "g", "former": "P", "no_faster": "<", "all": "l", "increment": "s", "together": "t",
    "back_to": "T", "long": "v",
}  # fmt: skip
"""Letters by which the grammar's patterns know them."""
NOUNS = {
    "position": "K", "angle": "K", "speed": "K", "height": "K", "value": "K", "amplitude": "a", "peak_to_peak": "k",
    "frequency": "f", "period": "q",
}  # fmt: skip
SHARES = {
    "half": 0.5, "third": 1.0 / 3.0, "quarter": 0.25, "fifth": 0.2, "eighth": 0.125, "tenth": 0.1,
    "two_thirds": 2.0 / 3.0, "three_quarters": 0.75, "double": 2.0, "triple": 3.0,
}  # fmt: skip
SHORT = re.compile("[^aeiou]+[aeiou][^aeiouwxy]")
"""A verb whose last letter is doubled before an ending."""
CONDITION = ("once", "if", "until", "settled", "it_is", "equals", "reaches", "becomes", "above", "below")
"""Parts of a condition, which mean nothing apart."""


class Symbol(NamedTuple):
    """What a phrase means: a letter for its kind, and a value of that kind."""

    kind: str
    value: Any
    text: str


@dataclass(frozen=True, eq=False)
class Lexicon:
    """The phrases of one language."""

    name: str
    table: Mapping[str, Any]
    courtesies: Sequence[re.Pattern[str]]
    """Of what says nothing wherever it stands, in small letters with one space between words."""

    @cached_property
    def meanings(self) -> Mapping[tuple[str, ...], tuple[tuple[str, Any], ...]]:
        """Kinds and values by the words of a phrase; none for what is dropped."""
        found: dict[tuple[str, ...], tuple[tuple[str, Any], ...]] = {}
        self._enter(found, "articles", ())
        for category, letter in {**ROLES, **NOUNS}.items():
            self._enter(found, category, ((letter, category),))
        for category, factor in SHARES.items():
            self._enter(found, category, (("S", factor),))
        for category, factor in {"halve": 0.5, "doubled": 2.0, "tripled": 3.0, "reversed": -1.0}.items():
            self._enter(found, category, (("V", "go"), ("S", factor)))
        for category in VERBS:
            self._enter(found, category, (("V", category),))
        self._enter(found, "over_to", (("V", "go"), ("T", "to")))
        self._enter(found, "slow_to", (("V", "go"), ("U", -1.0), ("h", "speed"), ("T", "to")))
        self._enter(found, "while_holding", ((";", "while"), ("V", "hold")))
        self._enter(found, "each_for", (("e", "every"), ("R", "for")))
        for category in ("while", "before"):
            self._enter(found, category, ((";", category),))
        self._enter(found, "step_through", (("V", "step"), ("T", "to")))
        self._enter(found, "at_rest", (("n", "rest"), ("T", "to"), ("Q", (0.0, None))))
        zero = (("V", "go"), ("n", "rest"), ("T", "to"), ("Q", (0.0, None)))
        self._enter(found, "nothing", zero)
        self._enter(found, "then_nothing", ((";", "then"), *zero))
        self._enter(found, "from_rest", (("n", "rest"), ("F", "from"), ("Q", (0.0, None))))
        for category, sign in {"climb_to": 1.0, "sink_to": -1.0}.items():
            self._enter(found, category, (("V", "go"), ("U", sign), ("h", "height"), ("T", "to")))
        self._enter(found, "level", (("n", "position"), ("V", "home")))
        self._enter(found, "back", (("y", "change"), ("V", "back")))
        for category, sign in {"back_up": 1.0, "back_down": -1.0}.items():
            self._enter(found, category, (("V", "back"), ("U", sign)))
        for category in ("displace", "turn", "change"):
            self._enter(found, category, (("y", category), ("V", "go")))
        self._enter(found, "lean", (("n", "position"), ("y", "turn"), ("V", "go")))
        for category in ("step", "ramp"):
            self._enter(found, category, (("y", "change"), ("V", category)))
        self._enter(found, "ease", (("V", "go"), ("C", "slowly")))
        for category, sign in {"raise": 1.0, "lower": -1.0}.items():
            self._enter(found, category, (("V", "go"), ("U", sign)))
        for noun, (more, less) in {"height": ("climb", "sink"), "speed": ("speed_up", "slow_down")}.items():
            for category, sign in ((more, 1.0), (less, -1.0)):
                self._enter(found, category, (("V", "go"), ("U", sign), ("h", noun)))
        for category, sign in {"up": 1.0, "down": -1.0}.items():
            self._enter(found, category, (("U", sign),))
        self._enter(found, "more", (("+", 1.0),))
        self._enter(found, "from_home", (("F", "from"), ("u", "home")))
        for category, sign in {"above_home": 1.0, "below_home": -1.0}.items():
            self._enter(found, category, (("U", sign), ("F", "from"), ("u", "home")))
        for category, sign in {"faster": 1.0, "slower": -1.0}.items():
            self._enter(found, category, (("M", sign),))
        for category, sign in {"bigger": 1.0, "smaller": -1.0}.items():
            self._enter(found, category, (("M", sign), ("a", "amplitude")))
        for category, end in {"all_up": "highest", "all_down": "lowest"}.items():
            self._enter(found, category, (("V", "go"), ("T", "to"), ("x", end)))
        for category in ("slowly", "quickly"):
            self._enter(found, category, (("C", category),))
        self._enter(found, "home_place", (("u", "home"),))
        self._enter(found, "then", ((";", "then"),))
        for words, meaning in list(found.items()):
            if words and "V" in {kind for kind, _ in meaning}:
                for form in self._forms(words[0]):
                    found.setdefault((*form, *words[1:]), meaning)
        for reason, phrases in self.table["refuse"].items():
            for phrase in phrases:
                words = tuple(folded(phrase).split())
                found[words] = (("!", reason), *(each for each in found.get(words, ()) if each[0] in "VUN"))
        return found

    @cached_property
    def _by_first(self) -> Mapping[tuple[str, Any], frozenset[tuple[str, ...]]]:
        found: dict[tuple[str, Any], set[tuple[str, ...]]] = {}
        for words, meaning in self.meanings.items():
            for first in meaning[:1]:
                found.setdefault(first, set()).add(words)
        return {first: frozenset(phrases) for first, phrases in found.items()}

    def meaning_first(self, first: tuple[str, Any]) -> frozenset[tuple[str, ...]]:
        """Phrases that mean this kind and value first."""
        return self._by_first.get(first, frozenset())

    def _forms(self, verb: str) -> Sequence[tuple[str, ...]]:
        """What else is said with a verb: "goes", "going", "to go" and "be moved", or, of an infinitive of a language
        whose ``endings`` are listed, "aumente", "aumenta", "aumentando" and "para aumentar".
        """
        if len(verb) > 3 and (endings := self.table.get("endings", {}).get(verb[-2:], ())):
            stem = verb[:-2]
            hard = {"c": f"{stem[:-1]}qu", "g": f"{stem}u"}.get(stem[-1:], stem) if verb.endswith("ar") else stem
            forms = [((hard if ending[0] == "e" else stem) + ending,) for ending in endings]
            return [*forms, *((to, verb) for to in self.table["before_infinitives"])]
        if "endings" in self.table or not verb.isalpha():
            return []
        doubled = verb + verb[-1] if SHORT.fullmatch(verb) else verb.removesuffix("e")
        participle = self.table["participles"].get(verb, f"{doubled}ed")
        passive = [(*before, participle) for before in ((), ("be",), ("is",), ("are",), ("to", "be"), ("should", "be"))]
        return [
            ("to", verb),
            (f"{verb}es" if verb.endswith(("s", "sh", "ch", "o")) else f"{verb}s",),
            (f"{doubled}ing",),
            *passive,
        ]

    def _enter(self, found: dict[tuple[str, ...], Any], category: str, meaning: Any) -> None:
        for phrase in self.table.get(category, ()):
            found[tuple(folded(phrase).split())] = meaning

    @cached_property
    def parts(self) -> Mapping[str, frozenset[tuple[str, ...]]]:
        """Phrases of conditions and of other words that are looked for in their place only."""
        return {
            category: frozenset(tuple(folded(phrase).split()) for phrase in self.table.get(category, ()))
            for category in (
                *CONDITION,
                "articles",
                "point",
                "object",
                "to",
                "ask",
                "asks_within",
                "definite",
                "steps",
                "applied",
                "correction",
                "negation",
                "again",
                "whole",
                "middle",
            )
        }

    @cached_property
    def plain_ways(self) -> frozenset[str]:
        """Words for up, down, forwards and backwards, which say what moves: a height, or a speed."""
        return frozenset(folded(each) for kind in ("up", "down", "forwards", "backwards") for each in self.table[kind])

    @cached_property
    def opening(self) -> re.Pattern[str]:
        """What somebody begins with who thinks, or takes up what was said before."""
        said = "|".join(re.escape(words) for words in sorted(self.table["opening"], key=len, reverse=True))
        return re.compile(rf"^(?:\s*(?:{said})(?!\w)[\s,.]*)+", re.IGNORECASE)

    @cached_property
    def closing(self) -> re.Pattern[str]:
        """What says at the end of a single part that it takes the place of what runs, as all commands do."""
        return re.compile(rf"^((?:[^,;:]|,(?=\d))*?)\s+(?:{'|'.join(self.table['closing'])})\W*$", re.IGNORECASE)

    @cached_property
    def units(self) -> Mapping[tuple[str, ...], str]:
        """Symbols of units by their names."""
        return {tuple(folded(name).split()): symbol for name, symbol in self.table["units"].items()}

    @cached_property
    def parts_of_one(self) -> Mapping[tuple[str, ...], float]:
        """Half, a third ... by their phrases."""
        shares = {name: share for name, share in SHARES.items() if share < 1.0}
        return {tuple(text.split()): share for name, share in shares.items() for text in self.table.get(name, ())}

    @cached_property
    def parts_more(self) -> Mapping[tuple[str, ...], float]:
        """What "and a half" adds, and its likes."""
        return {tuple(text.split()): share for text, share in self.table["and_a_part"].items()}

    @cached_property
    def verbs_of_numbers(self) -> frozenset[tuple[str, ...]]:
        """Phrases of a verb that begin with a number."""
        said = (tuple(folded(phrase).split()) for kind in ("home", "repeat", "bit") for phrase in self.table[kind])
        return frozenset(words for words in said if words[0] in {**self.table["numbers"], **self.table["signs"]})

    @cached_property
    def words(self) -> frozenset[str]:
        """All single words that mean something somewhere."""
        phrases = [*self.meanings, *self.units, *(phrase for part in self.parts.values() for phrase in part)]
        single = {*self.table["numbers"], *self.table["signs"], *self.table["parts_of"], *self.table["sizes"]}
        single |= {word for each in self.courtesies for word in re.findall(r"[a-z]+", each.pattern)}
        return frozenset(word for phrase in phrases for word in phrase) | single

    def courtesy(self, words: Sequence[str]) -> int:
        """How many of the next words are politeness or thinking aloud, 0 if none."""
        said = " ".join(words[: words.index("")] if "" in words else words)
        return max((match[0].count(" ") + 1 for each in self.courtesies if (match := each.match(said))), default=0)

    def longest(self, phrases: Any, words: Sequence[str]) -> int:
        """How many of the next words are one of some phrases, 0 if none."""
        for count in range(min(LONGEST_PHRASE, len(words)), 0, -1):
            if tuple(words[:count]) in phrases:
                return count
        return 0


@cache
def lexicon(name: str) -> Lexicon:
    """That of a language."""
    table = read_mapping(Path(__file__).parent / "words" / f"{name}.yaml")
    classes = table.pop("classes")
    courtesies = [_expression(phrase, classes) for phrase in table.pop("polite")]
    return Lexicon(name=name, table=_spread(table, classes), courtesies=courtesies)


def _expression(phrase: str, classes: Mapping[str, str]) -> re.Pattern[str]:
    """Of all that a phrase stands for, longer ones first."""
    written, groups = re.sub(r"<(\w+)>", lambda match: f"({classes[match[1]]})", phrase), list[str]()
    while match := re.search(r"\(([^()]*)\)", written):
        longest_first = "|".join(sorted(match[1].split("|"), key=len, reverse=True))
        groups.append(f"(?:{longest_first})")
        written = f"{written[: match.start()]}@{len(groups) - 1};{written[match.end() :]}"
    while "@" in written:
        written = re.sub(r"@(\d+);", lambda match: groups[int(match[1])], written)
    return re.compile(written + "(?= |$)")


def _spread(table: Any, classes: Mapping[str, str]) -> Any:
    """A table whose phrases are written out: "go (back|home)" stands for "go back" and "go home", and "<you> go" for
    as many as the class ``you`` has members.
    """
    if isinstance(table, Mapping):
        return {key: _spread(part, classes) for key, part in table.items()}
    return [each for phrase in table for each in _alternatives(phrase, classes)] if isinstance(table, list) else table


def _alternatives(phrase: str, classes: Mapping[str, str]) -> Sequence[str]:
    phrase = re.sub(r"<(\w+)>", lambda match: f"({classes[match[1]]})", phrase)
    match = re.search(r"\(([^()]*)\)", phrase)
    if match is None:
        return [" ".join(phrase.split())]
    made = (phrase[: match.start()] + each + phrase[match.end() :] for each in match[1].split("|"))
    return [written for each in made for written in _alternatives(each, classes)]
