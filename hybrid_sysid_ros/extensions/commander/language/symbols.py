"""Symbols: a text cut into what its phrases mean in one language, typing slips mended; every word means something."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Sequence
from typing import Any

from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Lexicon, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.quantities import QuantityReader, Token
from hybrid_sysid_ros.extensions.commander.language.stops import folded, stop_in
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary, meant
from hybrid_sysid_ros.support.errors import UserError

LONGEST = 300  # characters of a sentence
TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>[+-]?(?:\d{1,3}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d+|\d+(?:[.,]\d+)?|(?<!\w)[.,]\d+)(?:[eE][+-]?\d+)?(?![\w.]*\d))
    | (?P<sign>\+/?-|±)
    | (?P<path>"[^"]{1,200}"|'[^']{1,200}'|[\w~-][\w./~-]*\.(?i:csv|txt|jpe?g|png)\b)
    | (?P<unit>(?:%|°C?)(?:/(?:s|min)(?:\^2)?)?|[^\W\d_]+(?:/(?:s|min|h|sec|second)(?:\^2|²)?\b))
    | (?P<word>[^\W\d_](?:[\w]|[-'](?=[^\W\d_]))*|&|=|@)
    | (?P<mark>[,;.!?:\n])
    )""",
    re.VERBOSE,
)
TIMED = "wait|pause|hold|stay|in|within|for|after|every|over|of|half|just|about|takes?|then|and"
"""Words after which "a second" is a time, and no rate."""
PHRASES = (
    (re.compile(r"(?<=\d)½"), ".5"),
    (re.compile(r"½"), "0.5"),
    (re.compile(r"\.{3,}|\.{2}(?=\s|$)"), ", "),
    (re.compile(r"\b(?:times\s+(?:a|per|every)\s+sec(?:ond)?|vez(?:es)?\s+por\s+segundo)\b", re.I), " Hz "),
    (
        re.compile(r"\b(?:(once)|twice)\s+(?:a|per|every)\s+sec(?:ond)?\b", re.I),
        lambda match: f" at {2 - bool(match[1])} Hz ",
    ),
    (re.compile(r"\b(?:per|por)\s+sec(?:ond)?s?\b|\bpor\s+segundo\b", re.I), "/s "),
    (re.compile(rf"\b(?!(?:{TIMED})\b)([^\W\d_]+|%)\s+a\s+sec(?:ond)?s?\b", re.I), r"\1/s "),
    (re.compile(r"\bper\s+min(?:ute)?s?\b|\bpor\s+minuto\b", re.I), "/min "),
    (re.compile(r"\bper\s+h(?:our)?\b|\bpor\s+hora\b", re.I), "/h "),
    (re.compile(r"(?<=\w)\s*/\s*(s|min|h|seg)\b", re.I), lambda match: "/" + match[1].lower().replace("seg", "s")),
    (re.compile(r"/s\s*/\s*s\b"), "/s^2"),
    (re.compile(r"(?<=\d)\s*(?:N m|newton[ -]?met(?:er|re)s?)\b"), " Nm"),
    (re.compile(r"(?<=\d)(?=[^\W\d_])(?![eE][+-]?\d)"), " "),
)
"""What is written in several words, dots of somebody who thinks, and units that touch their number."""
BAND = re.compile(r"(?<=\d)\s*-\s*(?=\d+(?:[.,]\d+)?\s*[km]?Hz\b)")
PEAK_TO_PEAK = re.compile(r"(?<=\d)\s*([^\W\d_]{1,3})\s*(?:pp|p-p)\b")
"""As in "0.1-2 Hz" and "3 Vpp": they stand for a word of the language."""
LOOKALIKES = str.maketrans(
    {
        **{"\u2212": "-", "\u2013": "-", "\u2014": ",", "\u2019": "'", "\u00ba": "°", "\u03bc": "µ"},
        **{"\t": " ", "\u00bf": " ", "\u00a1": " ", "\u2026": ", "},
    }
)
"""Minus, dashes, apostrophe, ordinal, Greek mu and Spanish marks, as editors and phones write them."""


def symbols(text: str, lexicon: Lexicon, vocabulary: Vocabulary) -> list[Symbol]:
    """What a text says, symbol by symbol. Raises UserError for what means nothing in this language."""
    if not text.strip():
        raise UserError("empty: say for example 'hold 0'")
    if len(text) > LONGEST:
        raise UserError(f"{len(text)} characters: a command has {LONGEST} at most; for more, follow a file")
    said = BAND.sub(f" {lexicon.table['to'][0]} ", text.translate(LOOKALIKES))
    said = PEAK_TO_PEAK.sub(rf" \1 {lexicon.table['peak_to_peak'][0]} ", said)
    for phrase, other in PHRASES:
        said = phrase.sub(other, said)
    return _Reader(list(_tokens(said, vocabulary.rig.references)), lexicon, vocabulary).symbols()


def _tokens(text: str, whole: Container[str]) -> Iterator[Token]:
    """Kinds and texts of what a sentence is made of; words with a dash are two but for those in ``whole``."""
    position, end = 0, len(text.rstrip())
    while position < end:
        match = TOKEN.match(text, position)
        if match is None or match.end() == position:
            wrong = text[position:].lstrip()[:1]
            sign = "; a sign touches its number, as in -1" if wrong in "+-" else ""
            raise UserError(f"{wrong!r} means nothing in a command: leave it out{sign}")
        position, kind = match.end(), str(match.lastgroup)
        if kind == "word" and match[kind] not in whole:
            yield from (Token(kind, part) for part in re.split(r"[-_]", match[kind]))
        else:
            yield Token(kind, match[kind])


class _Reader(QuantityReader):
    """Reads tokens from left to right."""

    def __init__(self, tokens: list[Token], lexicon: Lexicon, vocabulary: Vocabulary) -> None:
        super().__init__(tokens, lexicon, vocabulary)
        self.found: list[Symbol] = []

    def symbols(self) -> list[Symbol]:
        self.mend()
        while self.at < len(self.tokens):
            self.take()
        return self.found

    def mend(self) -> None:
        """Put known words in the places of their slips. Raises UserError for a word that nothing resembles."""
        known = self.lexicon.words | self.vocabulary.words(self.lexicon.name)
        numbers = self.lexicon.table["numbers"]
        for k, (token, word) in enumerate(zip(self.tokens, self.words, strict=True)):
            if token.kind != "word" or word in known or token.text in self.vocabulary.rig.references:
                continue
            after_number = k > 0 and (self.tokens[k - 1].kind == "number" or self.words[k - 1] in numbers)
            if self.unit(token.text) is not None:
                continue
            owner, _, own = token.text.casefold().partition("'")
            if own == "s" and folded(owner) in known:  # "the bit's speed"
                self.words[k] = folded(owner)
                continue
            self.words[k] = self.mended(k, word, known, after_number)

    def mended(self, k: int, word: str, known: frozenset[str], after_number: bool) -> str:
        """The known word that a slip stands for. Raises UserError where there is none, or there are several."""
        other = any(word in lexicon(name).words for name in LANGUAGES)
        candidates = () if other or stop_in(word) else meant(word, known)  # "release" is no slip of "reverse"
        single = {**self.lexicon.meanings, **self.vocabulary.phrases}
        own = tuple(each for each in candidates if (each,) in single)
        units = tuple(each for each in candidates if (each,) in self.lexicon.units)
        candidates = (after_number and units) or own or candidates
        meanings = {single.get((each,), self.lexicon.units.get((each,), each)) for each in candidates}
        refused = any(kind == "!" for each in candidates for kind, _ in self.lexicon.meanings.get((each,), ()))
        a_number = any(each in self.lexicon.table["numbers"] for each in candidates)
        if len(meanings) == 1 and not refused and not a_number:
            return candidates[0]  # a number is asked for, not guessed: "even" is no seven
        place = 0
        while place < len(self.words):  # a negation says more than a word that nobody knows
            count = self.lexicon.longest(self.lexicon.meanings, self.words[place:])
            said = tuple(self.words[place : place + count])
            for kind, reason in self.lexicon.meanings[said] if count else ():
                if kind == "!":
                    raise UserError(f"{' '.join(said)!r}: {reason}")
            place += max(1, count)
        if after_number and not candidates:
            raise UserError(f"no unit {self.tokens[k].text[:40]!r}: known are {self.listed_units()}, s, Hz, %")
        raise UnknownWordError(self.tokens[k].text, candidates)

    def take(self) -> None:
        """The next phrase."""
        token = self.tokens[self.at]
        if token.kind == "mark":
            self.at += 1
            self.found.append(Symbol("," if token.text in ",:" else ";", token.text, token.text))
        elif token.kind == "sign":
            self.at += 1
            self.found.append(Symbol("p", "±", token.text))
        elif token.kind == "path":
            self.at += 1
            self.found.append(Symbol("G", token.text.strip("\"'"), token.text))
        elif token.kind == "unit":
            raise UserError(f"{token.text!r} has no number before it: write for example '3 {token.text}'")
        elif (quantity := self.quantity()) is not None:
            self.found.append(quantity)
        else:
            self.phrase()

    # Phrases.

    def phrase(self) -> None:
        """The longest phrase that begins here, of the language or of the rig."""
        words = self.words[self.at :]
        if self.condition():
            return
        own, count = (
            self.vocabulary.longest(words, self.lexicon),
            self._without_sign(self.longest(self.lexicon.meanings)),
        )
        text = self.tokens[self.at].text
        if text in self.vocabulary.rig.references and self._asks_to_follow():
            self.at += 1
            self.found.append(Symbol("G", text, text))
        elif (
            own is not None
            and (own[0] >= count or own[1].kind == "O")
            and not (count and own[1].kind == "!" and self._verb_here())
        ):
            self.at += own[0]
            self.found.append(own[1])
        elif count == 1 and self._article():
            self.at += 1
        elif count:
            self.mean(self.lexicon.meanings[tuple(words[:count])], " ".join(words[:count]))
            self.at += count
            if self.found and self.found[-1].kind == "S" and self._definite():
                self.found.append(Symbol("N", "present", ""))
        elif self.unit(text) is not None or self.longest(self.lexicon.units):
            raise UserError(f"{text!r} has no number before it: write for example '3 {text}'")
        else:
            raise UnknownWordError(text, ())

    def _without_sign(self, count: int) -> int:
        """How many of so many words are a phrase here: "a menos" says less, but "a menos cem rpm" goes to -100 rpm."""
        words = tuple(self.words[self.at : self.at + count])
        if count < 2 or words[-1] not in self.lexicon.table["signs"] or self.lexicon.meanings[words][0][0] not in "U+":
            return count
        at, self.at = self.at, self.at + count - 1
        signed, self.at = self._number_follows(), at
        return count - 1 if signed else count

    def mean(self, meanings: Sequence[tuple[str, Any]], said: str) -> None:
        """Note what a phrase means. "Climb" names the height and "accelerate" a speed, where there is one, and what
        says "level" needs a position. Raises UserError for a phrase that no command has, before others that nobody
        knows; "gain" is one, but not in "gain 100 m".
        """
        gains = len(meanings) > 1 and self._verb_here() and self._number_follows()
        for kind, reason in meanings if not gains else ():
            if kind == "!" and not (("N", "present") in meanings and self._noun(len(said.split()))[0]):
                raise UserError(f"{said!r}: {reason}")
        for noun in [value for kind, value in meanings if kind == "n"]:
            if not self.vocabulary.of_kind(noun):
                raise UserError(f"{said!r}: nothing here has a {noun}: say a value, as in 'go to 0'")
        self.found += [Symbol(kind, value, said) for kind, value in meanings if kind not in "hn!"]
        for noun in [value for kind, value in meanings if kind == "h"]:
            self.found += [Symbol("O", output, said) for output in self.vocabulary.of_kind(noun)[:1]]

    def _article(self) -> bool:
        """Whether a word that is an article or a preposition is an article here: no number follows."""
        if (self.word(),) not in self.lexicon.parts["articles"]:
            return False
        return self.at + 1 >= len(self.tokens) or not (
            self._number_follows() or self.tokens[self.at + 1].kind == "sign"
        )

    def _definite(self) -> bool:
        """Whether what a share is of is meant as it is: "half the speed", "a third of its height"."""
        skip = (
            1 if self.longest({words for words, said in self.lexicon.meanings.items() if said == (("o", "of"),)}) else 0
        )
        there = self.longest(self.lexicon.parts["definite"], skip=skip) or self.longest(self.lexicon.parts["definite"])
        return bool(there) and bool(self._noun(skip + 1)[0] or self._noun(1)[0])

    def _asks_to_follow(self) -> bool:
        verbs = [symbol.value for symbol in self.found if symbol.kind == "V"]
        return bool(verbs) and verbs[-1] == "follow"

    def _verb_here(self) -> bool:
        """Whether a word that names an input, too, is a verb: it begins the clause, without an article, and no "at" is
        behind it ("the drive at 2").
        """
        ahead = self.lexicon.meanings.get(tuple(self.words[self.at + 1 : self.at + 2]), ())
        if ahead[:1] == (("W", "at"),) or (self.at and (self.words[self.at - 1],) in self.lexicon.parts["articles"]):
            return False
        before = next((symbol.kind for symbol in reversed(self.found) if symbol.kind not in ","), "")
        return before in ("", ";", "j") and any(
            kind == "V" for kind, _ in self.lexicon.meanings.get((self.word(),), ())
        )

    def _noun(self, skip: int) -> tuple[int, list[Symbol]]:
        """How many of the words behind the next ones name an output, or the rig, and which output."""
        words = self.words[self.at + skip :]
        own, count = self.vocabulary.longest(words, self.lexicon), self.longest(self.lexicon.meanings, skip=skip)
        if own is not None and own[1].kind in "OJ":
            return own[0], [own[1]] if own[1].kind == "O" else []
        meanings = self.lexicon.meanings[tuple(words[:count])] if count else ()
        named = [Symbol(kind, value, " ".join(words[:count])) for kind, value in meanings if kind == "K"]
        return count if named else 0, named

    def condition(self) -> bool:
        """A condition such as "once it is still", "when it reaches 3 m" or "if the height drops below 3 m"."""
        parts = self.lexicon.parts
        begin = self.longest(parts["once"])
        if not begin or self.longest(self.lexicon.meanings) > begin:  # "once more"
            return False
        words = tuple(self.words[self.at : self.at + begin])
        start, when = " ".join(words), next((kind for kind in ("until", "if") if words in parts[kind]), "once")
        count, named, event = self._subject(begin)
        settled = 0 if when == "if" else self.longest(parts["settled"], skip=count)
        (at_once, side), (later, other) = self._relation(begin), self._relation(count, event=event)
        equals = self.longest(parts["equals"], skip=count - 1) == 1  # "when it is 2 m"
        equals = equals and not (at_once or later) and self._number_follows(count)
        if settled and count + settled >= max(begin + at_once, count + later):
            self.at += count + settled
            self.found.append(Symbol("Z", (when, 0.0), f"{start} it is still"))
            return True
        if at_once or later or equals:
            self.at += begin + at_once if at_once else count + later
            side = side if at_once else other
            when = "once" if when == "if" and (event or not side) else when
            self.found += [Symbol("z", (when, side), start), *([] if at_once else named[:1])]
            return True
        if words in self.lexicon.meanings:
            return False
        raise UserError(f"{start!r} what? say for example 'once it is still', 'when it reaches 1' or 'in 5 s'")

    def _subject(self, count: int) -> tuple[int, list[Symbol], bool]:
        """How many words there are with those that say of what a condition is, which output, and whether it becomes so,
        as in "the height drops".
        """
        parts, named, event = self.lexicon.parts, list[Symbol](), False
        for _ in range(3):
            count += max(self.longest(parts[kind], skip=count) for kind in ("it_is", "articles", "object"))
            more, nouns = self._noun(count)
            count, named = count + more, named + nouns
            more = self.longest(parts["becomes"], skip=count)
            if more and self._relation(count)[0] <= more:  # "passar de" a value is all one
                count, event = count + more, True
        return count, named, event

    def _relation(self, skip: int, *, event: bool = False) -> tuple[int, float]:
        """How many words lead to the value that is waited for, and on which side of it the output has to be."""
        parts = self.lexicon.parts
        lead = parts["reaches"] | parts["to"] if event else parts["reaches"]
        return max(
            (self.longest(lead, skip=skip), 0.0), (self.longest(parts["above"], skip=skip), 1.0),
            (self.longest(parts["below"], skip=skip), -1.0), key=lambda found: found[0],
        )  # fmt: skip


class UnknownWordError(UserError):
    """A word that means nothing."""

    def __init__(self, word: str, candidates: tuple[str, ...]) -> None:
        hint = (
            f"did you mean {' or '.join(candidates[:3])}?" if candidates
            else "say for example 'go to', 'hold', 'ramp to', 'step to', 'swing between', 'home' or 'stop'"
        )  # fmt: skip
        super().__init__(f"unknown word {word[:40]!r}: {hint}")
