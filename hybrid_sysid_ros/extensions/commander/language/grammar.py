"""Grammar: from a text to commands, in whichever language it is. What its verb can't take is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Condition,
    Home,
    Repeat,
    Sentence,
    Swing,
    Undo,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.joining import (
    KEPT_AND_CHANGED,
    acts,
    all_again,
    arrival,
    at_odds,
    brought_to_rest,
    carried,
    has_moved,
    held_each,
    joined,
    only_by,
    repeated,
    same_way,
    stands_alone,
)
from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.matcher import clauses
from hybrid_sysid_ros.extensions.commander.language.meanings import Meaning
from hybrid_sysid_ros.extensions.commander.language.paraphrases import JOINED
from hybrid_sysid_ros.extensions.commander.language.quantities import DoubtfulNumberError
from hybrid_sysid_ros.extensions.commander.language.questions import is_question
from hybrid_sysid_ros.extensions.commander.language.reading import read_by
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, folded, is_motionless, says_more, stop_in
from hybrid_sysid_ros.extensions.commander.language.symbols import UnknownWordError, symbols
from hybrid_sysid_ros.extensions.commander.language.values import Values
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

SWUNG = ("amplitude", "peak_to_peak", "frequency", "period")


STAYS = re.compile(r"(?:stay|remain|permane|fique|fica)")
"""Verbs of holding that leave a value where it is."""


FIRST = re.compile(r"\b(?:first|primeiro)\b", re.IGNORECASE)
RUNS = re.compile(r"\b(?:run|running|go|going|rodar|rodando)\b")
"""In a verb of holding, that what moves goes on."""


class DoubtfulTimeError(UserError):
    """What is to come later, of which is unclear when."""


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

    def sentence(found: Sequence[Symbol]) -> Sentence:
        return _stage(text, clauses(found, vocabulary, words), vocabulary, files)

    return read_by(symbols(text, words, vocabulary), sentence)


def _stage(
    text: str, found: Sequence[Clause], vocabulary: Vocabulary, files: Files, *, reached: bool = False
) -> Sentence:
    """The clauses up to the first condition, and behind it those that wait for it; reached: for a value, at which
    "hold" stays.
    """
    commands: list[Command] = []
    dwelt, still = False, set[int]()
    for k, clause in enumerate(found):
        if commands and isinstance(commands[-1], Swing) and (seconds := _lasting(clause, found[k - 1], vocabulary)):
            commands[-1] = replace(commands[-1], seconds=seconds)
            continue
        heads = not (k or clause.verbs) and len(found) > 1 and not found[1].then  # "three times: ..."
        if rounds := _rounds(clause, vocabulary, files) if commands or heads else 0:
            if not commands:
                return all_again(_stage(text, found[1:], vocabulary, files), rounds)
            if isinstance(commands[-1], Swing) and not _own_length(found[k - 1]):
                raise UserError(
                    f"{rounds} times: so many periods, or so often for as long as it lasts by default? say "
                    f"'for {rounds} periods', or for how long"
                )
            commands *= rounds
            continue
        if not clause.verbs and any(_is_bare(item, clause, vocabulary, first=not k) for item in clause.quantities):
            clause.verbs += [
                verb for verb in carried(commands, found[:k]) if verb.value != "hold" or not clause.directions
            ]
        if [way.kind for way in clause.directions] == ["+"]:
            clause.directions = same_way(clause, commands, vocabulary)  # "down 1 m, then another metre"
        if clause.then and only_by(clause):
            clause.directions = [Symbol("+", 1.0, clause.quantities[0].text)]  # "down by 1 m, then by 2 m"
            clause.directions = same_way(clause, commands, vocabulary)
            clause.directions = [way for way in clause.directions if way.kind == "U"]
        dwelt = (k < len(found) - 1 or dwelt) and _dwells(clause)
        verbs = [symbol.value for symbol in clause.verbs]
        if clause.condition is not None or (clause.delay is not None and not commands):
            until, already = (
                clause.condition is not None and clause.condition.when == when for when in ("until", "if")
            )
            condition = _condition(clause, vocabulary)
            settles = condition.settled
            waits = verbs in ([], ["wait"]) and stands_alone(clause)
            if until and "halt" in verbs:
                raise UserError("'stop' works at once: let it stand alone, or at the end")
            if until and not waits:
                commands.append(Meaning(clause, vocabulary, files, behind=acts(commands)).command())
            rest = found[k + 1 :] if until or waits else [clause, *found[k + 1 :]]
            if not rest and commands and until and settles:
                return Sentence(text=text, commands=tuple(commands))  # "go to 1 m and let it settle": it does
            if not rest:
                raise UserError("and then what? say for example 'once it is still, go to 0'")
            later = _stage(text, rest, vocabulary, files, reached=condition.output is not None)
            if already and not later.is_stop:
                raise UserError(
                    "if it is so now, or as soon as it is? say 'when it goes above' or 'below', or leave it out"
                )
            return Sentence(text=text, commands=tuple(commands), condition=condition, later=later)
        if "halt" in verbs and clause.paces and commands:  # "then shut it down gently in 10 s"
            commands.append(brought_to_rest(clause, vocabulary))
            continue
        if clause.delay is not None:
            seconds = Values(clause, vocabulary).delay()
            if "halt" in verbs and not clause.then:
                raise DoubtfulTimeError(
                    f"stop {clause.delay.text}: from now, or when the rest is done? say 'stop {clause.delay.text}' "
                    f"alone before it, or 'then wait {seconds:g} s, then stop'"
                )
            if clause.delay.role == "starting" and not stands_alone(clause):
                raise UserError(
                    f"{clause.delay.text!r}: of all, or of the last part? say 'in {seconds:g} s' before the first, "
                    f"or 'then wait {seconds:g} s'"
                )
            commands.append(Wait(seconds=seconds))
        if "halt" in verbs:
            if clause.quantities or (clause.here and commands):
                commands.append(arrival(clause))
                continue
            if k == 0 and not commands:
                follows = any([symbol.value for symbol in other.verbs] != ["halt"] for other in found[1:])
                why = "a stop ends a command: say the rest when it has stopped" if follows else ""
                return Sentence(text=text, commands=(), stops=True, why=why)
            if k < len(found) - 1:
                raise UserError("'stop' works at once: let it stand alone, or at the end")
            if not clause.then and all(isinstance(command, Repeat) for command in commands):
                commands = []  # "again, stop!"
            return Sentence(text=text, commands=tuple(commands), stops=True)
        # "stay 5 s at each"
        lasting = clause.each is not None and stands_alone(clause) and verbs in ([], ["hold"], ["wait"])
        if not ((clause.delay is not None and stands_alone(clause) and not verbs) or lasting):
            behind = acts(commands) or (reached and verbs == ["hold"])
            joint, clause.together = (clause.together, "") if commands else ("", clause.together)
            if clause.comparatives and not k and len(found) > 1 and not found[1].then and not clause.quantities:
                said = clause.comparatives[0][1]
                raise UserError(f"{said!r}: of what runs, or of what follows? say 'slowly', or 'then' behind it")
            meaning = Meaning(clause, vocabulary, files, behind=behind)
            here, kept = clause.here, {*clause.targets}
            made = meaning.command()
            other = k > 0 and [verb.text for verb in clause.verbs] != [verb.text for verb in found[k - 1].verbs]
            if FIRST.search(text) and any(isinstance(command, Repeat) for command in commands):
                raise UserError("which comes first? say 'repeat' alone, or the parts in their order, joined by 'then'")
            if commands == [made] and made in (Repeat(), Undo()) and other and not JOINED.search(text):
                continue  # "one more time, same as before"
            if re.search(r"\b(?:is|are|esta)\b", here) and isinstance(made, Wait) and has_moved(commands, kept):
                raise UserError(f"{here!r}: where it is now, or is then? say 'stay there', or leave it out")
            stays = bool(clause.verbs) and STAYS.match(clause.verbs[0].text) is not None
            if not clause.then and (doubt := at_odds(commands, made, stays=stays, still=still)):
                raise UserError(doubt)
            still = kept if made == Wait(seconds=0.0) else set()
            if clause.meanwhile and still and has_moved(commands, still):
                raise UserError(KEPT_AND_CHANGED)
            joint = joint or ("while" if clause.meanwhile and not isinstance(made, Wait) else "")
            commands = (
                joined(commands, made, joint)
                if joint
                else repeated(commands, made, meaning.times, joined=not clause.then)
            )
        if clause.each is not None:
            commands = held_each(commands, clause.each, Values(clause, vocabulary).time(clause.each))
    return Sentence(text=text, commands=tuple(commands))


def _lasting(clause: Clause, before: Clause, vocabulary: Vocabulary) -> float:
    """How long a swing lasts where the next part says no more, as in "run it for 20 s"; 0 for any other."""
    runs = [symbol for symbol in clause.verbs if symbol.value == "hold" and RUNS.search(symbol.text)]
    others = [symbol for symbol in clause.verbs if symbol.text.split()[0] != "repeat"]
    said = {"follow" if symbol in runs else symbol.value for symbol in others}
    times = [item for item in clause.quantities if item.base == TIME and item.role in ("for", "over")]
    if (
        not said
        or said - {"follow", "repeat"}
        or times != clause.quantities
        or len(times) != 1
        or _own_length(before)
        or clause.names
        or clause.then
    ):
        return 0.0
    return Values(clause, vocabulary).time(times[0])


def _dwells(clause: Clause) -> bool:
    """Whether a bare time behind a value is how long it lasts, as another part follows: "60 rpm, 5 s, then 30 rpm"."""
    times = [item for item in clause.quantities if item.base == TIME]
    moved = {symbol.value for symbol in clause.verbs} <= {"go", "step", "hold", "follow"} and not clause.paces
    if not moved or clause.increment or clause.count_of_steps or len(times) != 1 or times[0].role or times[0].kind:
        return False
    at = clause.quantities.index(times[0])
    clause.quantities[at] = replace(times[0], role="for") if at or clause.shares else times[0]
    return bool(at or clause.shares)


def _own_length(clause: Clause) -> bool:
    """Whether a clause says how long or how often."""
    return any(item.role == "for" or item.base == COUNT for item in clause.quantities)


def _rounds(clause: Clause, vocabulary: Vocabulary, files: Files) -> int:
    """How often the other parts are carried out, where a part says no more than that; 0 for any other."""
    twice = [share for share in clause.shares if not share.role and not share.of and share.factor > 1.0]
    counted = [*twice, *(item for item in clause.quantities if item.base == COUNT)]
    said = [*clause.quantities, *clause.shares]
    if len(counted) != 1 or said != counted or {symbol.value for symbol in clause.verbs} - {"repeat"}:
        return 0
    whole = replace(clause, verbs=[Symbol("V", "repeat", "repeat")])
    made = Meaning(whole, vocabulary, files).command()
    return made.times if isinstance(made, Repeat) else 0


def _is_bare(item: Quantity, clause: Clause, vocabulary: Vocabulary, *, first: bool) -> bool:
    """Whether a value needs no verb: it measures an output ("60 rpm"), or goes on with what the part before does."""
    if item.kind in SWUNG or item.role not in (("", "at") if first else ("", "at", "to")):
        return False
    own = (unit for k in vocabulary.tracked for unit in vocabulary.units_of(k))
    measures = item.unit is not None and any(map(item.unit.alike, own))
    only = len([k for k in vocabulary.tracked if vocabulary.outputs[k].moves]) == 1
    measures = measures or (
        item.value == 0.0 and item.unit is None and (item.output is not None or only)
    )  # "zero speed"
    measures = measures or (item.base == PERCENT and item.kind == "speed" and only)
    return not first or (measures and (item.role == "" or clause.addressed or clause.sense is not None))


def _condition(clause: Clause, vocabulary: Vocabulary) -> Condition:
    """What a clause waits for; it is taken from the clause."""
    meaning = Values(clause, vocabulary)
    if clause.condition is None:
        found = Condition(delay=meaning.delay())
        clause.delay = None
        return found
    _, reached, side = clause.condition
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
    return Condition(output=output, value=value, side=side)
