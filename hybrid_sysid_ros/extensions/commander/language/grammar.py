"""Grammar: from a text to commands, in whichever language it is. What its verb can't take is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, clauses
from hybrid_sysid_ros.extensions.commander.language.commands import Command, Condition, Move, Repeat, Sentence, Wait
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.meanings import Meaning
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, folded, stop_in
from hybrid_sysid_ros.extensions.commander.language.symbols import UnknownWordError, symbols
from hybrid_sysid_ros.extensions.commander.language.values import Values
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.errors import UserError

CARRIED = ("go", "hold", "ramp", "step", "follow")
"""Verbs that count for the next part, too, where it has a value and no verb."""


class DoubtfulTimeError(UserError):
    """What is to come later, of which is unclear when."""


def read(text: str, vocabulary: Vocabulary, files: Files | None = None) -> Sentence:
    """The commands of a sentence; files: those that it may follow. A text that says stop and is not understood is a
    stop, and one that speaks of an emergency is one whatever else it says. Raises UserError for any other that is not
    understood, in a line that says what to write instead, or that asks which of two readings is meant.
    """
    said = stop_in(text)
    if said == EMERGENCY:
        return Sentence(text=text, commands=(), stops=True, emergency=True)
    understood: list[Sentence] = []
    refusals: dict[str, UserError] = {}
    for language in LANGUAGES:
        try:
            understood.append(_sentence(text, language, vocabulary, files or Files()))
        except UserError as refusal:
            refusals[language] = refusal
    if not understood:
        found = refusals[_language(text, vocabulary)]
        if said:
            why = str(found) if isinstance(found, DoubtfulTimeError) else ""
            return Sentence(text=text, commands=(), stops=True, why=why)
        raise _foreign(found, text, vocabulary) if isinstance(found, UnknownWordError) else found
    if any(other != understood[0] for other in understood):
        raise UserError("this means one thing in English and another in Portuguese: say it in other words")
    return understood[0]


def _known(text: str, language: str, vocabulary: Vocabulary) -> tuple[int, int]:
    """How many of a text's words a language knows, and how many there are."""
    words, known = re.findall(r"[^\W\d_]{2,}", folded(text)), lexicon(language).words.union(vocabulary.spoken[language])
    return sum(word in known for word in words), len(words)


def _language(text: str, vocabulary: Vocabulary) -> str:
    """That which knows most of a text's words."""
    return max(LANGUAGES, key=lambda name: _known(text, name, vocabulary))


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
    return _stage(text, clauses(symbols(text, lexicon(language), vocabulary), vocabulary), vocabulary, files)


def _stage(text: str, found: Sequence[Clause], vocabulary: Vocabulary, files: Files) -> Sentence:
    """The clauses up to the first condition, and behind it those that wait for it."""
    commands: list[Command] = []
    for k, clause in enumerate(found):
        if k and not clause.verbs and any(item.role in ("", "at") for item in clause.quantities):
            clause.verbs += _carried(commands, found[k - 1])
        verbs = [symbol.value for symbol in clause.verbs]
        if clause.condition is not None or (clause.delay is not None and not commands):
            until = clause.condition is not None and clause.condition[0] == "until"
            condition = _condition(clause, vocabulary)
            waits = verbs in ([], ["wait"]) and _alone(clause)
            if until and not waits:
                commands.append(Meaning(clause, vocabulary, files, behind=_acts(commands)).command())
            rest = found[k + 1 :] if until or waits else [clause, *found[k + 1 :]]
            if not rest:
                raise UserError("and then what? say for example 'once it is still, go to 0'")
            later = _stage(text, rest, vocabulary, files)
            return Sentence(text=text, commands=tuple(commands), condition=condition, later=later)
        if clause.delay is not None:
            seconds = Values(clause, vocabulary).delay()
            if "halt" in verbs and not clause.then:
                raise DoubtfulTimeError(
                    f"stop {clause.delay.text}: from now, or when the rest is done? say 'stop {clause.delay.text}' "
                    f"alone before it, or 'then wait {seconds:g} s, then stop'"
                )
            commands.append(Wait(seconds=seconds))
        if "halt" in verbs:
            if clause.here or clause.quantities:
                commands.append(_arrival(clause))
                continue
            if k == 0 and not commands:
                more = any([symbol.value for symbol in other.verbs] != ["halt"] for other in found[1:])
                why = "a stop ends a command: say the rest when it has stopped" if more else ""
                return Sentence(text=text, commands=(), stops=True, why=why)
            if k < len(found) - 1:
                raise UserError("'stop' works at once: let it stand alone, or at the end")
            return Sentence(text=text, commands=tuple(commands), stops=True)
        if not (clause.delay is not None and _alone(clause) and not verbs):
            commands.append(Meaning(clause, vocabulary, files, behind=_acts(commands)).command())
    return Sentence(text=text, commands=tuple(commands))


def _carried(commands: Sequence[Command], before: Clause) -> list[Symbol]:
    """The verbs of a part that count for the next one, too, as in "hold 1 m, then 2 m". After "up 1 m" the next value
    could be a change or a place, so there is none.
    """
    last = commands[-1] if commands else None
    if not isinstance(last, Move) or any(goal.relative or goal.share for goal in last.goals):
        return []
    return [symbol for symbol in before.verbs if symbol.value in CARRIED] or [Symbol("V", "go", "go")]


def _acts(commands: Sequence[Command]) -> bool:
    """Whether commands lead somewhere, which "there" and "again" may mean."""
    return any(not isinstance(command, Repeat) for command in commands)


def _arrival(clause: Clause) -> Command:
    """What "and stop there" asks for: to stay."""
    if clause.quantities or clause.targets or clause.directions:
        raise UserError("'stop' works at once: say 'go to' or 'hold' where the rig is to stay")
    return Wait(seconds=0.0)


def _alone(clause: Clause) -> bool:
    """Whether a clause says nothing beside a condition or a delay."""
    return not (
        clause.quantities or clause.shares or clause.targets or clause.directions or clause.names or clause.here
        or clause.comparatives or clause.nouns
    )  # fmt: skip


def _condition(clause: Clause, vocabulary: Vocabulary) -> Condition:
    """What a clause waits for; it is taken from the clause."""
    meaning = Values(clause, vocabulary)
    if clause.condition is None:
        found = Condition(delay=meaning.delay())
        clause.delay = None
        return found
    _, reached = clause.condition
    if clause.delay is not None:
        raise UserError("a delay and a condition contradict one another: leave one out")
    clause.condition = None
    if reached is None:
        return Condition()
    output = meaning.output(reached)
    value, shown = meaning.value(reached, output), vocabulary.outputs[output]
    low, high = (float(end[output]) / shown.scale for end in vocabulary.rig.reach)
    if not low <= value <= high:
        raise DoubtfulTimeError(
            f"{shown.name} never reaches {value:.4g} {shown.unit}: "
            f"give a value from {low:.4g} to {high:.4g} {shown.unit}"
        )
    return Condition(output=output, value=value)
