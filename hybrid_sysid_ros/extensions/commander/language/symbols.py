"""Symbols: a text cut into what its phrases mean in one language, typing slips mended; every word means something."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Sequence
from typing import Any

from hybrid_sysid_ros.extensions.commander.language.corrections import CorrectionReader
from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Lexicon, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.paraphrases import written_out
from hybrid_sysid_ros.extensions.commander.language.parts import is_level
from hybrid_sysid_ros.extensions.commander.language.quantities import Token
from hybrid_sysid_ros.extensions.commander.language.stops import folded, stop_in
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary, meant
from hybrid_sysid_ros.rigs.units import COUNT, TIME
from hybrid_sysid_ros.support.errors import UserError

SHAPES = {"step", "ramp", "swing", "square", "toggle", "triangle", "chirp", "stairs"}
"""Verbs whose noun may be applied."""
ENCLITICS = {"a", "o", "as", "os", "la", "lo", "las", "los", "me", "nos", "lhe"}
"""Portuguese pronouns behind a dash, which name the rig: "sobe-a quatro" is not "sobe a quatro"."""
LONGEST = 300  # characters of a sentence
TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>[+-]?(?:\d{1,3}(?:(?:\.\d{3})+,|(?:,\d{3})+\.)\d+|\d+(?:[.,]\d+)?|(?<!\w)[.,]\d+)(?:[eE][+-]?\d+)?(?![\w.]*\d))
    | (?P<sign>\+/?-|±)
    | (?P<path>"[^"]{1,200}"|'[^']{1,200}'|[\w~-][\w./~-]*\.(?i:csv|txt|jpe?g|png)\b)
    | (?P<unit>(?:%|°C?)(?:/(?:s|min)(?:\^2)?)?|[^\W\d_]+(?:/(?:s|min|h|sec|second)(?:\^2|²)?\b))
    | (?P<word>[^\W\d_](?:[\w]|[-'](?=[^\W\d_]))*|&|=|@|[<>]=?)
    | (?P<mark>[,;.!?:\n])
    )""",
    re.VERBOSE,
)


def symbols(text: str, lexicon: Lexicon, vocabulary: Vocabulary) -> list[Symbol]:
    """What a text says, symbol by symbol. Raises UserError for what means nothing in this language."""
    if not text.strip():
        raise UserError("empty: say for example 'hold 0'")
    if len(text) > LONGEST:
        raise UserError(f"{len(text)} characters: a command has {LONGEST} at most; for more, follow a file")
    said = written_out(text, lexicon)
    return _Reader(list(_tokens(said, vocabulary.rig.references)), lexicon, vocabulary).symbols()


def _counts(quantity: Symbol) -> bool:
    """Whether a quantity says how many times."""
    return quantity.value[1] is not None and bool(quantity.value[1].base == COUNT)


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
            first, *parts = re.split(r"[-_]", match[kind])
            yield Token(kind, first)
            yield from (Token(kind, part) for part in parts if folded(part) not in ENCLITICS)
        else:
            yield Token(kind, match[kind])


class _Reader(CorrectionReader):
    """Reads tokens from left to right."""

    def symbols(self) -> list[Symbol]:
        self.mend()
        while self.at < len(self.tokens):
            self.take()
        return self.found

    def mend(self) -> None:
        """Put "more" behind the unit that follows it, as in "two more degrees", and known words in the places of their
        slips. Raises UserError for a word that nothing resembles.
        """
        self.count_single_times()
        known = self.lexicon.words | self.vocabulary.words(self.lexicon.name)
        numbers = self.lexicon.table["numbers"]
        for k in range(1, len(self.tokens) - 1):
            counted = self.tokens[k - 1].kind == "number" or self.words[k - 1] in numbers
            if counted and self.words[k] in ("more", "extra", "further", "less") and self._unit_at(k + 1) is not None:
                self.tokens[k : k + 2] = self.tokens[k + 1], self.tokens[k]
                self.words[k : k + 2] = self.words[k + 1], self.words[k]
        for k, (token, word) in enumerate(zip(self.tokens, self.words, strict=True)):
            owner, _, own = token.text.casefold().partition("'")
            if own == "s" and folded(owner) in self.vocabulary.words(self.lexicon.name):  # "the bit's speed"
                self.words[k] = folded(owner)
                continue
            if token.kind != "word" or word in known or token.text in self.vocabulary.rig.references:
                continue
            after_number = k > 0 and (self.tokens[k - 1].kind == "number" or self.words[k - 1] in numbers)
            if self.unit(token.text) is not None:
                continue
            if own == "s" and folded(owner) in known:  # "the machine's speed"
                self.words[k] = folded(owner)
                continue
            self.words[k] = self.mended(k, word, known, after_number)

    def count_single_times(self) -> None:
        """Write "another minute" and "cada segundo" with their 1, and "another two minutes" without the other word."""
        another, each = (frozenset(self.lexicon.table[key]) for key in ("another", "each_time"))
        for k in range(len(self.words) - 1, -1, -1):
            if self.words[k] not in another | each:
                continue
            self.at, ahead = k + 1, None
            if self.at < len(self.tokens):
                unit = self.unit_here()
                self.at = k + 1
                ahead = None if unit or self.words[k] in each else self.quantity()
                if unit is not None and unit.base == TIME and not unit.per:
                    here = k + (self.words[k] in each)
                    self.tokens[here : k + 1] = [Token("number", "1")]
                    self.words[here : k + 1] = [""]
                elif ahead is not None and ahead.kind == "Q" and ahead.value[1] and ahead.value[1].base == TIME:
                    del self.tokens[k], self.words[k]
        self.at = 0

    def mended(self, k: int, word: str, known: frozenset[str], after_number: bool) -> str:
        """The known word that a slip stands for. Raises UserError where there is none, or there are several."""
        other = any(word in lexicon(name).words for name in LANGUAGES)
        candidates = () if other or stop_in(word) else meant(word, known)  # "release" is no slip of "reverse"
        single = {**self.lexicon.meanings, **self.vocabulary.phrases}
        own = tuple(each for each in candidates if (each,) in single)
        units = tuple(each for each in candidates if (each,) in self.lexicon.units)
        if after_number:  # "5 holes" is no "hold 5"
            own = tuple(each for each in own if "V" not in {kind for kind, _ in self.lexicon.meanings.get((each,), ())})
        candidates = (after_number and units) or own or (() if after_number else candidates)
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
            raise self.vocabulary.no_unit(self.tokens[k].text)
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
        elif self.counts_each():
            self.phrase()
        elif (quantity := self.quantity()) is not None:
            self.found.append(quantity)
        else:
            self.phrase()

    def counts_each(self) -> bool:
        """Whether "a cycle" behind a value says that each takes so long: "ten seconds a cycle"."""
        said = tuple(self.words[self.at : self.at + self.longest(self.lexicon.meanings)])
        behind = bool(self.found) and self.found[-1].kind == "Q" and not _counts(self.found[-1])
        return behind and any(kind == "e" for kind, _ in self.lexicon.meanings.get(said, ()))

    # Phrases.

    def phrase(self) -> None:
        """The longest phrase that begins here, of the language or of the rig."""
        words = self.words[self.at :]
        if self.corrected() or self.condition():
            return
        own, count = (
            self.vocabulary.longest(words, self.lexicon),
            self._without_sign(self.longest(self.lexicon.meanings)),
        )
        text, courtesy = self.tokens[self.at].text, self.lexicon.courtesy(words)
        if (way := self.vocabulary.way(self.word(), self.lexicon)) and count < 2:
            self.at += 1
            self.found += way
        elif text in self.vocabulary.rig.references and self._asks_to_follow():
            self.at += 1
            self.found.append(Symbol("G", text, text))
        elif (
            own is not None
            and (own[0] >= count or own[1].kind == "O")
            and not (count and own[1].kind == "!" and self._verb_here())
        ):
            self.at += own[0]
            self.found.append(own[1])
        elif count == 1 and self._led_by_article() and (self.word(),) in self.lexicon.parts["object"]:
            self.found.append(Symbol("J", "object", self.word()))  # "the nose", which may be a verb elsewhere
            self.at += 1
        elif courtesy and courtesy >= count:
            self.at += courtesy
        elif (count == 1 and self._article()) or self._each_of(count):
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
        kinds = [kind for kind, _ in self.lexicon.meanings.get(words, ())]
        if count > 1 and words[-1] == "another" and kinds[:1] == ["V"] and self._number_follows(count):
            return count - 1  # "and another 200"
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
        articles = self.longest(self.lexicon.parts["articles"], skip=1)
        more = self.longest(self.lexicon.meaning_first(("+", 1.0)), 1)
        skip = 1 + max(articles, more, self.lexicon.courtesy(self.words[self.at + 1 :]))
        gains = len(meanings) > 1 and self._number_follows(skip)
        if ("!" in [kind for kind, _ in meanings]) and self._applied(len(said.split())):
            return
        for kind, reason in meanings if not gains else ():
            if kind == "!" and not (("N", "present") in meanings and self._noun(len(said.split()))[0]):
                raise UserError(f"{said!r}: {reason}")
        if (";", "before") in meanings and self.longest(self.lexicon.parts["reaches"], skip=len(said.split())):
            raise UserError(f"{said!r}: nothing watches for that: say 'when it reaches' a value")
        if "x" in [kind for kind, _ in meanings] and said in self.vocabulary.words_of_names:
            raise UserError(f"{said!r}: the highest value, or a part of the rig? say 'to the maximum', or a value")
        if (
            {("n", "rest"), ("T", "to")} <= {*meanings}
            and ("V", "go") not in meanings
            and not self._in_time(len(said.split()))
        ):
            self.found.append(Symbol("V", "halt", said))
            return
        for noun in [value for kind, value in meanings if kind == "n"]:
            if ("V", "home") in meanings and self.vocabulary.of_kind("height"):
                self.found.append(Symbol("V", "hold", said))  # a vehicle that levels off stays where it is
                return
            if not self.vocabulary.of_kind(noun):
                raise UserError(f"{said!r}: nothing here has a {noun}: say a value, as in 'go to 0'")
        if ("N", "present") in meanings and said.endswith("was") and self.found and self.found[-1].value == "back_to":
            meanings = [("P", "former")]  # "put it back to what it was"
        if ("u", "home") in meanings and (said,) in self.lexicon.parts["middle"] and self._number_follows(1):
            meanings = [("A", "around")]
        if ("B", "between") in meanings and self._ends(len(said.split())):  # "5 s between"
            meanings = [("e", "every")]
        spoken_of = bool(self.found) and self.found[-1].kind in "OK"  # "let the speed go up by 10 m/s"
        self.found += [Symbol(kind, value, said) for kind, value in meanings if kind not in "hn!"]
        before = self.found[: -len(meanings)]
        kinds = "".join(each.kind for each in before)
        if ("V", "step") in meanings and re.search("(?:^|[^TFQ])Q$", kinds) and is_level(before[-1]):
            self.found = [*before[:-1], self.found[-1], Symbol("Y", "by", ""), before[-1]]  # "a 2 m step"
        for noun in [value for kind, value in meanings if kind == "h" and not spoken_of]:
            self.found += [Symbol("O", output, said) for output in self.vocabulary.of_kind(noun)[:1]]

    def _ends(self, count: int) -> bool:
        """Whether so many words end a part."""
        return self.at + count >= len(self.tokens) or self.tokens[self.at + count].kind == "mark"

    def _in_time(self, skip: int) -> bool:
        """Whether a time follows, as in "to a stop in 5 s"."""
        marked = [token.text for token in self.tokens[self.at + skip :][:1]] == [","]
        skip += marked
        count = self.longest(self.lexicon.meanings, skip=skip)
        said = self.lexicon.meanings.get(tuple(self.words[self.at + skip :][:count]), ())
        return bool(said) and said[0][0] in "ILiRr" and self._number_follows(skip + count)

    def _applied(self, count: int) -> bool:
        """Whether "apply" is of a motion, in the same part: "apply a step of 1 m", "apply a 2 m step"."""
        if tuple(self.words[self.at : self.at + count]) not in self.lexicon.parts["applied"]:
            return False
        for k in range(self.at + count, len(self.tokens)):
            words = tuple(self.words[k : k + self.lexicon.longest(self.lexicon.meanings, self.words[k:])])
            meanings = self.lexicon.meanings.get(words, ())
            if any(kind == "V" and value in SHAPES for kind, value in meanings):
                return True
            if self.tokens[k].kind == "mark" or any(kind in "V;j!" for kind, _ in meanings):
                return False
        return False

    def _article(self) -> bool:
        """Whether a word that is an article or a preposition is an article here: no number follows."""
        if (self.word(),) not in self.lexicon.parts["articles"]:
            return False
        return self.at + 1 >= len(self.tokens) or not (
            self._number_follows() or self.tokens[self.at + 1].kind == "sign"
        )

    def _led_by_article(self) -> bool:
        """Whether an article stands before this word."""
        return self.at > 0 and (self.words[self.at - 1],) in self.lexicon.parts["articles"]

    def _each_of(self, count: int) -> bool:
        """Whether "a zigzag" does not stand behind what each one takes, so that its article says nothing."""
        said = self.lexicon.meanings.get(tuple(self.words[self.at : self.at + count]), ())
        return any(kind == "e" for kind, _ in said) and self.word() in ("a", "um", "uma") and not self.counts_each()

    def _definite(self) -> bool:
        """Whether what a share is of is meant as it is: "half the speed", "a third of its height"."""
        skip = 1 if self.longest(self.lexicon.meaning_first(("o", "of"))) else 0
        there = self.longest(self.lexicon.parts["definite"], skip=skip) or self.longest(self.lexicon.parts["definite"])
        return bool(there) and bool(self._noun(skip + 1)[0] or self._noun(1)[0])

    def _asks_to_follow(self) -> bool:
        verbs = [symbol.value for symbol in self.found if symbol.kind == "V"]
        return bool(verbs) and verbs[-1] in ("follow", "repeat")

    def _verb_here(self) -> bool:
        """Whether a word that names an input, too, is a verb: it begins the clause, without an article, and no "at" is
        behind it ("the drive at 2").
        """
        ahead = self.lexicon.meanings.get(tuple(self.words[self.at + 1 : self.at + 2]), ())
        if ahead[:1] == (("W", "at"),) or self._led_by_article():
            return False
        before = next((symbol.kind for symbol in reversed(self.found) if symbol.kind not in ","), "")
        return before in ("", ";", "j") and any(
            kind == "V" for kind, _ in self.lexicon.meanings.get((self.word(),), ())
        )


class UnknownWordError(UserError):
    """A word that means nothing."""

    def __init__(self, word: str, candidates: tuple[str, ...]) -> None:
        hint = (
            f"did you mean {' or '.join(candidates[:3])}?" if candidates
            else "say for example 'go to', 'hold', 'ramp to', 'step to', 'swing between', 'home' or 'stop'"
        )  # fmt: skip
        super().__init__(f"unknown word {word[:40]!r}: {hint}")
