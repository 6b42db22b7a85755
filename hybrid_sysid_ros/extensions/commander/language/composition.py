"""Composition: the commands of a sentence's clauses, each from what it says and from what goes before."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Condition,
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
    has_stayed,
    held_each,
    joined,
    only_by,
    repeated,
    same_way,
    stands_alone,
)
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.meanings import Meaning
from hybrid_sysid_ros.extensions.commander.language.paraphrases import JOINED
from hybrid_sysid_ros.extensions.commander.language.values import Values
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

SWUNG = ("amplitude", "peak_to_peak", "frequency", "period")
STAYS = re.compile(r"(?:stay|remain|permane|fique|fica)")
"""Verbs of holding that leave a value where it is."""
BACK = re.compile(r"(?:back|de volta|volta)\b")
FIRST = re.compile(r"\b(?:first|primeiro)\b", re.IGNORECASE)
RUNS = re.compile(r"\b(?:run|running|go|going|rodar|rodando)\b")
"""In a verb of holding, that what moves goes on."""


class DoubtfulTimeError(UserError):
    """What is to come later, of which is unclear when."""


@dataclass(kw_only=True)
class Composition:
    """The clauses up to the first condition, and behind it those that wait for it."""

    text: str
    found: Sequence[Clause]
    vocabulary: Vocabulary
    files: Files
    reached: bool = False
    """Whether they wait for a value, at which "hold" stays."""
    commands: list[Command] = field(default_factory=list)
    still: set[int] = field(default_factory=set)
    """Outputs that the clause before was said to keep."""

    def sentence(self) -> Sentence:
        """What they say. Raises UserError for what can't be, is doubtful, or leaves something open."""
        dwelt = False
        for k, clause in enumerate(self.found):
            if self.prolongs(k) or self.counts(k):
                continue
            if k + 1 < len(self.found) and not self.commands and (rounds := self.heads(k)):
                return all_again(replace(self, found=self.found[1:], commands=[]).sentence(), rounds)
            if len(self.found) == 1 and not clause.verbs and (rounds := self.rounds(clause)):
                raise UserError(f"{rounds} times what? say 'repeat {rounds} times', or what to do so often")
            listed = self.takes_verb(k)
            dwelt = (k + 1 < len(self.found) or dwelt) and _dwells(clause)
            if clause.condition is not None or (clause.delay is not None and not self.commands):
                return self.waiting(k)
            if clause.delay is not None and not ("halt" in clause.said and clause.paces):
                self.delays(k)
            if "halt" in clause.said:
                if (stopped := self.stops(k)) is not None:
                    return stopped
                continue
            if not (stands_alone(clause) and (clause.delay or clause.each) and set(clause.said) <= {"hold", "wait"}):
                self.acts(k, listed=listed)
            if clause.each is not None:
                seconds = Values(clause, self.vocabulary).time(clause.each)
                self.commands = held_each(self.commands, clause.each, seconds)
        return self.ended()

    def ended(self, *, stops: bool = False, why: str = "") -> Sentence:
        return Sentence(text=self.text, commands=tuple(self.commands), stops=stops, why=why)

    def prolongs(self, k: int) -> bool:
        """Whether a clause says how long the swing before lasts and no more, as in "run it for 20 s"."""
        clause, last = self.found[k], self.commands[-1] if self.commands else None
        runs = [symbol for symbol in clause.verbs if symbol.value == "hold" and RUNS.search(symbol.text)]
        others = [symbol for symbol in clause.verbs if symbol.text.split()[0] != "repeat"]
        said = {"follow" if symbol in runs else symbol.value for symbol in others}
        times = [item for item in clause.quantities if item.base == TIME and item.role in ("for", "over")]
        lasts = said and said <= {"follow", "repeat"} and times == clause.quantities and len(times) == 1
        if not (isinstance(last, Swing) and lasts) or _own_length(self.found[k - 1]) or clause.names or clause.then:
            return False
        self.commands[-1] = replace(last, seconds=Values(clause, self.vocabulary).time(times[0]))
        return True

    def counts(self, k: int) -> bool:
        """Whether a clause says how often all before it is carried out, and no more."""
        rounds = self.rounds(self.found[k]) if self.commands else 0
        if rounds and isinstance(self.commands[-1], Swing) and not _own_length(self.found[k - 1]):
            raise UserError(
                f"{rounds} times: so many periods, or so often for as long as it lasts by default? say "
                f"'for {rounds} periods', or for how long"
            )
        self.commands *= rounds or 1
        return rounds > 0

    def heads(self, k: int) -> int:
        """How often all behind a first clause is carried out: "three times: ..."; 0 where it says anything else."""
        return 0 if k or self.found[k].verbs or self.found[k + 1].then else self.rounds(self.found[k])

    def rounds(self, clause: Clause) -> int:
        """How often, where a clause says no more than that; 0 for any other."""
        twice = [share for share in clause.shares if not share.role and not share.of and share.factor > 1.0]
        counted = [*twice, *(item for item in clause.quantities if item.base == COUNT)]
        said = [*clause.quantities, *clause.shares]
        rest = replace(clause, verbs=[], quantities=[], shares=[])
        if len(counted) != 1 or said != counted or set(clause.said) - {"repeat"} or not rest.empty:
            return 0
        whole = replace(clause, verbs=[Symbol("V", "repeat", "repeat")])
        made = Meaning(whole, self.vocabulary, self.files).command()
        return made.times if isinstance(made, Repeat) else 0

    def takes_verb(self, k: int) -> bool:
        """Give a clause the verb and the direction of those before it where it has none; whether it is one more value
        of a list then, of which nobody says how long each lasts.
        """
        clause, before = self.found[k], self.found[:k]
        led = clause.directions or clause.sense or {item.role for item in clause.quantities} & {"in", "within"}
        back = any(item.role == "to" and BACK.match(item.text) for item in clause.quantities)
        bare = set(clause.said) <= {"hold"} and not (led or back)
        if not clause.verbs and any(self.is_bare(item, clause, first=not k) for item in clause.quantities):
            carry = carried(self.commands, before, then=clause.then)
            clause.verbs += [verb for verb in carry if verb.value != "hold" or not clause.directions]
        if [way.kind for way in clause.directions] == ["+"]:
            clause.directions = same_way(clause, self.commands, self.vocabulary)  # "down 1 m, then another metre"
        if clause.then and only_by(clause):
            clause.directions = [Symbol("+", 1.0, clause.quantities[0].text)]  # "down by 1 m, then by 2 m"
            clause.directions = same_way(clause, self.commands, self.vocabulary)
            clause.directions = [way for way in clause.directions if way.kind == "U"]
        return bare and not clause.meanwhile and not any(other.each for other in self.found[k:])

    def is_bare(self, item: Quantity, clause: Clause, *, first: bool) -> bool:
        """Whether a value needs no verb: it measures an output, or goes on with what the part before does."""
        if item.kind in SWUNG or item.role not in (("", "at") if first else ("", "at", "to")):
            return False
        own = (unit for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k))
        only = len([k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves]) == 1
        measures = item.unit is not None and any(map(item.unit.alike, own))
        zero = item.value == 0.0 and item.unit is None and (item.output is not None or only)  # "zero speed"
        measures = measures or zero or (item.base == PERCENT and item.kind == "speed" and only)
        return not first or (measures and (item.role == "" or clause.addressed or clause.sense is not None))

    def waiting(self, k: int) -> Sentence:
        """What is carried out before the condition of a clause, and what waits for it."""
        clause, rest = self.found[k], self.found[k + 1 :]
        when = "" if clause.condition is None else clause.condition.when
        condition = self.condition(clause)
        waits = set(clause.said) <= {"wait"} and stands_alone(clause)
        if when == "until" and "halt" in clause.said:
            raise UserError("'stop' works at once: let it stand alone, or at the end")
        if when == "until" and not waits:
            self.commands.append(Meaning(clause, self.vocabulary, self.files, behind=acts(self.commands)).command())
        rest = rest if when == "until" or waits else [clause, *rest]
        if not rest and self.commands and when == "until" and condition.settled:
            return self.ended()  # "go to 1 m and let it settle": it does
        if not rest:
            raise IncompleteError("and then what? say for example 'once it is still, go to 0'")
        later = replace(self, found=rest, commands=[], still=set(), reached=condition.output is not None).sentence()
        if self.commands and any(isinstance(made, Repeat) and made.times > 1 for made in later.commands):
            raise UserError("so many times more, or in all, and each once that is so? say all parts, one by one")
        if when == "if" and not later.is_stop:
            raise UserError(
                "if it is so now, or as soon as it is? say 'when it goes above' or 'below', or leave it out"
            )
        return replace(self.ended(), condition=condition, later=later)

    def condition(self, clause: Clause) -> Condition:
        """What a clause waits for; it is taken from the clause."""
        values = Values(clause, self.vocabulary)
        if clause.condition is None:
            delay, clause.delay = values.delay(), None
            return Condition(delay=delay)
        if clause.delay is not None:
            raise UserError("a delay and a condition contradict one another: leave one out")
        (_, reached, side), clause.condition = clause.condition, None
        if reached is None:
            return Condition()
        output = values.output(reached)
        value, shown = values.value(reached, output), self.vocabulary.outputs[output]
        low, high = (float(end[output]) / shown.scale for end in self.vocabulary.rig.reach)
        if not low <= value <= high:
            raise DoubtfulTimeError(
                f"{shown.name} never reaches {value:.4g} {shown.unit}: "
                f"give a value from {low:.4g} to {high:.4g} {shown.unit}"
            )
        return Condition(output=output, value=value, side=side)

    def delays(self, k: int) -> None:
        """Wait for the delay of a clause behind others. Raises UserError where it could be of all, or is of nothing."""
        clause = self.found[k]
        assert clause.delay is not None
        seconds, said = Values(clause, self.vocabulary).delay(), clause.delay.text
        if "halt" in clause.said and not clause.then:
            raise DoubtfulTimeError(
                f"stop {said}: from now, or when the rest is done? say 'stop {said}' alone before it, or "
                f"'then wait {seconds:g} s, then stop'"
            )
        last = k == len(self.found) - 1 and stands_alone(clause) and not clause.said
        if last or clause.delay.role == "starting":
            raise IncompleteError(
                f"{said!r}: of all, or of the last part? say 'in {seconds:g} s' before the first, or "
                f"'then wait {seconds:g} s'"
            )
        self.commands.append(Wait(seconds=seconds))

    def stops(self, k: int) -> Sentence | None:
        """The sentence that ends in a stop; None for a stop that takes its time, or that stays somewhere."""
        clause, behind = self.found[k], self.found[k + 1 :]
        if clause.paces and self.commands:  # "then shut it down gently in 10 s"
            self.commands.append(brought_to_rest(clause, self.vocabulary))
            return None
        if clause.quantities or (clause.here and self.commands):
            self.commands.append(arrival(clause))
            return None
        if k == 0 and not self.commands:
            follows = any(other.said != ["halt"] for other in behind)
            return self.ended(stops=True, why="a stop ends a command: say the rest when it has stopped" * follows)
        if behind:
            raise UserError("'stop' works at once: let it stand alone, or at the end")
        if not clause.then and all(isinstance(command, Repeat) for command in self.commands):
            self.commands = []  # "again, stop!"
        return self.ended(stops=True)

    def acts(self, k: int, *, listed: bool) -> None:
        """Add what a clause asks for; listed: as one more value of a list."""
        clause, commands = self.found[k], self.commands
        joint, clause.together = (clause.together, "") if commands else ("", clause.together)
        if clause.comparatives and not k and len(self.found) > 1 and not self.found[1].then and not clause.quantities:
            said = clause.comparatives[0][1]
            raise UserError(f"{said!r}: of what runs, or of what follows? say 'slowly', or 'then' behind it")
        behind = acts(commands) or (self.reached and clause.said == ["hold"])
        meaning = Meaning(clause, self.vocabulary, self.files, behind=behind)
        here, kept = clause.here, {*clause.targets}
        made = meaning.command()
        if FIRST.search(self.text) and any(isinstance(command, Repeat) for command in commands):
            raise UserError("which comes first? say 'repeat' alone, or the parts in their order, joined by 'then'")
        other = k > 0 and [verb.text for verb in clause.verbs] != [verb.text for verb in self.found[k - 1].verbs]
        if commands == [made] and made in (Repeat(), Undo()) and other and not JOINED.search(self.text):
            return  # "one more time, same as before"
        if re.search(r"\b(?:is|are|esta)\b", here) and isinstance(made, Wait) and has_moved(commands, kept):
            raise UserError(f"{here!r}: where it is now, or is then? say 'stay there', or leave it out")
        stays = bool(clause.verbs) and STAYS.match(clause.verbs[0].text) is not None
        if not clause.then and (doubt := at_odds(commands, made, stays=stays, listed=listed, still=self.still)):
            raise UserError(doubt)
        if clause.then and stays and made == Wait(seconds=0.0) and not here and has_stayed(commands, self.vocabulary):
            raise UserError("keep the speed that it has then, or stand still? say 'then keep it', or 'then go to 0'")
        self.still = kept if made == Wait(seconds=0.0) else set()
        if clause.meanwhile and self.still and has_moved(commands, self.still):
            raise UserError(KEPT_AND_CHANGED)
        joint = joint or ("while" if clause.meanwhile and not isinstance(made, Wait) else "")
        self.commands = (
            joined(commands, made, joint) if joint else repeated(commands, made, meaning.times, joined=not clause.then)
        )


def _dwells(clause: Clause) -> bool:
    """Whether a bare time behind a value is how long it lasts, as another part follows: "60 rpm, 5 s, then 30 rpm"."""
    times = [item for item in clause.quantities if item.base == TIME]
    moved = set(clause.said) <= {"go", "step", "hold", "follow"} and not clause.paces
    if not moved or clause.increment or clause.count_of_steps or len(times) != 1 or times[0].role or times[0].kind:
        return False
    at = clause.quantities.index(times[0])
    clause.quantities[at] = replace(times[0], role="for") if at or clause.shares else times[0]
    return bool(at or clause.shares)


def _own_length(clause: Clause) -> bool:
    """Whether a clause says how long or how often."""
    return any(item.role == "for" or item.base == COUNT for item in clause.quantities)
