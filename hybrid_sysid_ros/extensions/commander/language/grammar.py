"""Grammar: from a text to commands, in whichever language it is. What its verb can't take is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.bare_numbers import BareNumbers
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Home,
    Sentence,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.completeness import is_complete
from hybrid_sysid_ros.extensions.commander.language.composition import Composition, DoubtfulTimeError
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.matcher import clauses
from hybrid_sysid_ros.extensions.commander.language.parts import marked
from hybrid_sysid_ros.extensions.commander.language.quantities import DoubtfulNumberError
from hybrid_sysid_ros.extensions.commander.language.questions import is_question
from hybrid_sysid_ros.extensions.commander.language.reading import read_by
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, folded, is_motionless, says_more, stop_in
from hybrid_sysid_ros.extensions.commander.language.symbols import UnknownWordError, symbols
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.errors import UserError


def read(text: str, vocabulary: Vocabulary, files: Files | None = None) -> Sentence:
    """The commands of a sentence, none of a question; files: those that it may follow. A text that says stop and is not
    understood is a stop, and one that speaks of an emergency is one whatever else it says. Raises UserError for any
    other that is not understood, in a line that says what to write instead, or asks which of two readings is meant.
    """
    said = stop_in(text)
    if said == EMERGENCY:
        return Sentence(text=text, commands=(), stops=True, emergency=True)
    if is_question(text):
        return Sentence(text=text, commands=(), asks=True)
    understood: list[Sentence] = []
    refusals: dict[str, UserError] = {}
    for language in LANGUAGES:
        try:
            understood.append(_sentence(text, language, vocabulary, files or Files()))
        except UserError as refusal:
            refusals[language] = refusal
    if not understood:
        reason = refusals[_language(text, vocabulary)]
        if said:
            why = str(reason) if isinstance(reason, DoubtfulTimeError) or says_more(text) else ""
            return Sentence(text=text, commands=(), stops=True, why=why)
        raise _foreign(reason, text, vocabulary) if isinstance(reason, UnknownWordError) else reason
    doubt = refusals.get(_language(text, vocabulary))
    if isinstance(doubt, DoubtfulNumberError):
        raise doubt  # "1,000", which only the other language reads
    if any(other != understood[0] for other in understood):
        raise UserError("this means one thing in English and another in Portuguese: say it in other words")
    found = understood[0]
    if (
        is_motionless(text)
        and found.later is None
        and [type(command) for command in found.commands] in ([Home], [Wait])
    ):
        return Sentence(text=text, commands=(), stops=True)  # "stand still" alone
    return found


def _known(text: str, language: str, vocabulary: Vocabulary) -> tuple[int, int]:
    """How many of a text's words a language knows, and how many there are."""
    words, known = re.findall(r"[^\W\d_]{2,}", folded(text)), lexicon(language).words.union(vocabulary.spoken[language])
    return sum(word in known for word in words), len(words)


def _language(text: str, vocabulary: Vocabulary) -> str:
    """That which knows most of a text's words, and the first where two know as many."""
    first = text.split()[0] if text.split() else ""
    return max(LANGUAGES, key=lambda name: (_known(text, name, vocabulary), _known(first, name, vocabulary)))


def _foreign(refusal: UserError, text: str, vocabulary: Vocabulary) -> UserError:
    """A refusal, which says which languages are read where a text seems to be in none of them."""
    known, count = _known(text, _language(text, vocabulary), vocabulary)
    if count < 2 or known > 0.5 * count:
        return refusal
    example = vocabulary.outputs[vocabulary.tracked[0]].unit if vocabulary.tracked else ""
    return UserError(
        f"{refusal}; commands are in English or Portuguese, as in 'go to 1 {example}', 'vá para 1 {example}'"
    )


def _sentence(text: str, language: str, vocabulary: Vocabulary, files: Files) -> Sentence:
    words = lexicon(language)
    found = marked(BareNumbers(symbols(text, words, vocabulary), vocabulary, words).with_units())

    def complete(part: Sequence[Symbol]) -> bool:
        return is_complete(part, vocabulary, files)

    def sentence(parts: Sequence[Sequence[Symbol]]) -> Sentence:
        made = clauses(parts, vocabulary)
        return Composition(text=text, found=made, vocabulary=vocabulary, files=files).sentence()

    return read_by(found, complete, sentence)
