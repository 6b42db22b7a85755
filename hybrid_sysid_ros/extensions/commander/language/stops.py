"""Stops: whether a text says stop in one of five languages, whatever else it says."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

from hybrid_sysid_ros.support.structured import read_mapping

STOP, EMERGENCY = "stop", "emergency"
TOKEN = re.compile(r"[^\W\d_]+|\d+|[.,;:!?\n]")
SPELLED = re.compile(r"\b(?:[a-z] ){2,}[a-z]\b")
REPEATED = re.compile(r"(\w)\1+")
SHORTEST = 4
"""Letters of a word that may hold slips."""


class _Patterns(NamedTuple):
    """Of normalised texts."""

    emergency: re.Pattern[str]
    stop: re.Pattern[str]
    not_stop: re.Pattern[str]
    not_emergency: re.Pattern[str]
    more: re.Pattern[str]
    motionless: re.Pattern[str]
    slips: frozenset[str]
    whole: frozenset[str]
    """Those whose slips these are."""
    articles: frozenset[str]


def stop_in(text: str) -> str:
    """EMERGENCY, STOP, or "" for a text that says neither, or says "don't" before. An emergency that is negated stops,
    since it is in doubt, and does not latch.
    """
    patterns = _patterns()
    said = _normalised(text, patterns)
    said = patterns.not_stop.sub(" ", patterns.not_emergency.sub(f" {STOP} ", said))
    if patterns.emergency.search(said):
        return EMERGENCY
    return STOP if patterns.stop.search(said) or patterns.slips & set(said.split()) else ""


def says_more(text: str) -> bool:
    """Whether a text that says stop says a value, a condition or a "not" beside it."""
    patterns = _patterns()
    said = patterns.motionless.sub(" ", _normalised(text, patterns))
    return any(letter.isdigit() for letter in text) or patterns.more.search(said) is not None


def is_motionless(text: str) -> bool:
    """Whether a text asks for standstill, as "stand still" does."""
    patterns = _patterns()
    return patterns.motionless.search(_normalised(text, patterns)) is not None


def folded(text: str) -> str:
    """In small letters, without accents and apostrophes."""
    split = unicodedata.normalize("NFKD", text.casefold().replace("'", "").replace("\u2019", ""))
    return "".join(letter for letter in split if not unicodedata.combining(letter))


def _normalised(text: str, patterns: _Patterns) -> str:
    """Words with a space around each, "|" for marks; letters that were repeated or spelled out are joined, and words
    that a space has cut ("st op").
    """
    said = " ".join("|" if len(word) == 1 and not word.isalnum() else word for word in TOKEN.findall(_apart(text)))
    said = SPELLED.sub(lambda match: match[0].replace(" ", ""), said.replace(" | ", "|").replace("|", " | "))
    words = said.split()
    for k in range(len(words) - 1, 0, -1):
        if words[k - 1] + words[k] in patterns.whole:
            words[k - 1 : k + 1] = [words[k - 1] + words[k]]
    return f" {' '.join(_joined(word) for word in words if word not in patterns.articles)} "


def _apart(text: str) -> str:
    """Plain: "d'urgence" in two words, "Not-Halt" in one, "s.t.o.p" in letters, and "st0p" with its letter."""
    text = re.sub(r"\bnot-(?=\w{3})", "not", text, flags=re.IGNORECASE)
    split = re.sub(r"\b([dlnst])['\u2019](?=\w{2})", r"\1 ", text, flags=re.IGNORECASE)
    return re.sub(r"(?<=\b[a-z])[.-](?=[a-z]\b)", " ", re.sub(r"(?<=[a-z])0(?=[a-z])", "o", folded(split)))


def _joined(word: str) -> str:
    """With each letter once where it is repeated, in words of SHORTEST letters."""
    return REPEATED.sub(r"\1", word) if len(word) >= SHORTEST else word


def _phrase(words: str) -> str:
    """The expression of a phrase; "*" for up to three words of the same clause."""
    parts = [r"(?:(?!nicht )[^ |]+ ){0,3}" if word == "*" else f"{re.escape(_joined(word))} " for word in words.split()]
    return " " + "".join(parts)


def _any(phrases: Iterable[str]) -> str:
    return f"(?:{'|'.join(_phrase(words)[1:] for words in sorted(phrases, key=len, reverse=True))})"


@cache
def _patterns() -> _Patterns:
    """Those of the table."""
    table = read_mapping(Path(__file__).parent / "words" / "stops.yaml")
    emergency, cry, anywhere, motionless, edge, alone = (
        _any([words for language in table[kind].values() for words in language])
        for kind in ("emergency", "cry", "anywhere", "motionless", "edge", "alone")
    )
    stop = rf"(?<= )(?:{anywhere}|{motionless})|(?:^ |\| ){edge}|(?<= ){edge}(?:$|\|)|^ (?:\| )*(?:{alone}(?:\| )*)+$"
    unless = {kind: _any(words) for kind, words in table["unless"].items()}
    before, whole = rf"{unless['before']}(?:{unless['between']})?", unless["whole"]
    not_stop = rf"(?<= )(?:{before}(?:{anywhere}|{edge})|(?:no|nao) {unless['with_no']}|{whole})"
    return _Patterns(
        emergency=re.compile(rf"(?<= ){emergency}|(?:^ |\| ){cry}+(?=$|\|)"),
        stop=re.compile(stop),
        not_stop=re.compile(not_stop),
        not_emergency=re.compile(
            rf"(?<= )(?:{before}|{_any(table['not_an'])})(?:{_any(['press', 'hit', 'push', 'use'])})?{emergency}"
        ),
        more=re.compile(rf"(?<= ){_any(table['more'])}"),
        motionless=re.compile(rf"(?<= ){motionless}"),
        slips=frozenset(slip for word in table["slips"] for slip in _slips(word) if len(slip) >= SHORTEST) - {"step"},
        whole=frozenset(table["slips"]),
        articles=frozenset(table["articles"]),
    )


def _slips(word: str) -> Iterable[str]:
    """A word with two neighbours swapped, or one letter left out that is not its first or last."""
    for k in range(len(word) - 1):
        yield _joined(word[:k] + word[k + 1] + word[k] + word[k + 2 :])
        if k and len(word) > SHORTEST:
            yield _joined(word[:k] + word[k + 1 :])
