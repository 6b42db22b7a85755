"""Vocabulary: what the names of a rig mean in commands, and which word a typing slip was meant to be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from hybrid_sysid_ros.extensions.commander.language.lexicon import LANGUAGES, Lexicon, Symbol, lexicon
from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.rigs import units
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.units import Unit
from hybrid_sysid_ros.runtime.set_points import SetPointRange, set_point_ranges
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import refuse_unknown, section

SHORTEST = 4  # letters of a known word that may be written with a slip
LONG = 7  # letters of one that may be written with two


@dataclass(frozen=True, kw_only=True, eq=False)
class Vocabulary:
    """The words that mean something at a rig. Names of what is not steered are known, so that they are refused."""

    rig: Rig
    outputs: tuple[SetPointRange, ...]

    @classmethod
    def of(cls, rig: Rig) -> Vocabulary:
        """That of a rig."""
        return cls(rig=rig, outputs=set_point_ranges(rig))

    @cached_property
    def tracked(self) -> tuple[int, ...]:
        """The outputs that commands may ask for."""
        return tuple(k for k, output in enumerate(self.outputs) if output.tracked)

    @cached_property
    def steered(self) -> str:
        """Names of these."""
        return ", ".join(self.outputs[k].name for k in self.tracked) or "nothing"

    @cached_property
    def names(self) -> Mapping[str, int]:
        """Tracked outputs by their names, and by those of joints that carry one of them each."""
        found: dict[str, int] = {}
        for joint in self.rig.joints.joints:
            carried = [k for k in self.tracked if self.rig.joints.place(self.outputs[k].name)[0] == joint]
            if len(carried) == 1:
                found[joint.lower()] = carried[0]
        return found | {self.outputs[k].name.lower(): k for k in self.tracked}

    @cached_property
    def phrases(self) -> Mapping[tuple[str, ...], Symbol]:
        """What the rig's names mean; of the names of inputs, states and outputs that are not steered: why not."""
        steered = {self.outputs[k].name for k in self.tracked}
        refused = {item.name: f"{item.name} is an input, which the controller sets: say where {self.steered} is to go"
                   for item in self.rig.system.inputs}  # fmt: skip
        for item in (*self.rig.system.states, *self.rig.system.outputs):
            if item.name not in steered:
                refused.setdefault(item.name, f"{item.name} is not steered by the controller: it tracks {self.steered}")
        found: dict[tuple[str, ...], Symbol] = {}
        own = _words(self.rig.name)
        for part in (own, *((word,) for name in (self.rig.name, *self.rig.joints.joints) for word in _words(name))):
            if not _means_something(part):
                found[part] = Symbol("J", "object", " ".join(part))
        for name, reason in refused.items():
            for word in _words(name):
                if len(word) > 2 and not _means_something((word,)) and (word,) not in self._own_parts:
                    found[(word,)] = Symbol("!", reason, word)
        for name, reason in refused.items():
            if not _is_noun(_words(name)):
                found[_words(name)] = Symbol("!", reason, name)
        for name, k in self.names.items():
            found[_words(name)] = Symbol("O", k, name)
        return found

    def watched_here(self, words: Sequence[str], language: Lexicon) -> tuple[int, list[Symbol]] | None:
        """How many of the next words name an output that is not steered, and which."""
        own = self.spoken[language.name]
        named = {_words(o.name): Symbol("O", k, o.name) for k, o in enumerate(self.outputs) if not o.tracked}
        said = [own.get(word, word) for word in words]
        count = language.longest(named, said)
        return (count, [named[tuple(said[:count])]]) if count else None

    @cached_property
    def words_of_names(self) -> frozenset[str]:
        """Words of the names of what there is to steer, to measure and to estimate."""
        named = (*self.rig.system.states, *self.rig.system.outputs)
        return frozenset(word for item in named for word in _words(item.name))

    @cached_property
    def _own_parts(self) -> frozenset[tuple[str, ...]]:
        """Words of tracked outputs' names and of joints that carry one."""
        return frozenset((word,) for name in self.names for word in _words(name))

    @cached_property
    def spoken(self) -> Mapping[str, Mapping[str, str]]:
        """By language, words of the rig's names by what else people say for them: ``names`` of its file; "+NAME" and
        "-NAME" by words for a direction of that output. Raises UserError for a language that is not read, a word that
        is in no name, and what means something in any command.
        """
        given, where = section(self.rig.content, "names", str(self.rig.file)), f"{self.rig.file}: names"
        refuse_unknown(given, LANGUAGES, where)
        ways = (sign + self.outputs[k].name for sign in "+-" for k in self.tracked)
        own = (*sorted({word for phrase in self.phrases for word in phrase}), *ways)
        found: dict[str, dict[str, str]] = {language: {} for language in LANGUAGES}
        for language in given:
            named, here = section(given, language, where), f"{where}.{language}"
            refuse_unknown(named, own, here)
            for name, others in named.items():
                if not isinstance(others, list) or not all(isinstance(each, str) and each.isalpha() for each in others):
                    raise UserError(f"{here}.{name} is {others!r}: it needs a list of single words")
                for word in map(folded, others):
                    spoken = lexicon(language)
                    known, side = (spoken.meanings.get((each,)) for each in (word, spoken.table["side"]))
                    if known and not (known == side and name[0] in "+-"):
                        raise UserError(f"{here}.{name}: {word!r} means something in all commands: take another word")
                    found[language][word] = name
        return found

    def words(self, language: str) -> frozenset[str]:
        """All of the rig's in a language."""
        return frozenset(word for phrase in self.phrases for word in phrase).union(self.spoken[language])

    def longest(self, words: Sequence[str], language: Lexicon) -> tuple[int, Symbol] | None:
        """How many of the next words are a name of the rig, and what it means."""
        own = self.spoken[language.name]
        said = [own.get(word, word) for word in words]
        count = language.longest(self.phrases, said)
        return (count, self.phrases[tuple(said[:count])]) if count else None

    @cached_property
    def sides(self) -> frozenset[str]:
        """Words for a direction of an output, as "left" of a yaw."""
        return frozenset(word for words in self.spoken.values() for word, name in words.items() if name[0] in "+-")

    def way(self, word: str, language: Lexicon) -> tuple[Symbol, Symbol] | None:
        """A direction, and the output of which it is, where the rig has a word for it, as "left" of a yaw."""
        name = self.spoken[language.name].get(word, "")
        if name[:1] not in ("+", "-"):
            return None
        return Symbol("U", 1.0 if name[0] == "+" else -1.0, word), Symbol("O", self.names[name[1:].lower()], word)

    @cached_property
    def units(self) -> Mapping[str, Unit]:
        """All that the table names, and those in which this rig's outputs are shown."""
        own = [text for output in self.outputs for text in (output.unit, self.si(output)) if text]
        return {**units.words(), **{text: units.of_rig(text) for text in own}}

    def si(self, output: SetPointRange) -> str:
        """The unit in which an output travels."""
        return next(item.unit for item in self.rig.system.outputs if item.name == output.name)

    def units_of(self, output: int) -> tuple[Unit, Unit]:
        """Those in which an output may be given: as it is shown, and as it travels."""
        shown = self.outputs[output]
        return units.of_rig(shown.unit), units.of_rig(self.si(shown))

    def no_unit(self, text: str) -> UserError:
        """A refusal of what is no unit, which lists those of this rig's outputs."""
        tracked = [self.outputs[k] for k in self.tracked]
        found = [text for output in tracked for text in (output.unit, self.si(output)) if text]
        listed = ", ".join(dict.fromkeys([*found, *(["deg"] if "rad" in found else [])]))
        return UserError(f"no unit {text[:40]!r}: known are {listed}, s, Hz, %")

    def only_unit(self, output: int) -> Unit | None:
        """That in which an output may be given, where what it is shown in measures the same as what it travels in."""
        shown, travels = self.units_of(output)
        return shown if shown.alike(travels) else None

    def of_kind(self, noun: str) -> list[int]:
        """Tracked outputs that a general word such as "speed" or "angle" may mean."""
        # what moves along has a place that is none of its angles
        drives = any(self.units_of(k)[1].base == "m" and self.units_of(k)[1].per for k in self.tracked)
        wanted = {
            "speed": lambda k, si: si.per == 1, "height": lambda k, si: self.outputs[k].name == "height",
            "angle": lambda k, si: (si.base, si.per) == ("rad", 0),
            "rest": lambda k, si: si.per == 1 and self.outputs[k].name not in self.rig.system.operating_point,
            "position": lambda k, si: si.per == 0 and self.outputs[k].name != "height" and not drives,
            "value": lambda k, si: True,
        }[noun]  # fmt: skip
        return [k for k in self.tracked if wanted(k, self.units_of(k)[1])]


def spoken_names(rig: Rig) -> Mapping[str, Mapping[str, str]]:
    """What else people say for the words of a rig's names: see :attr:`Vocabulary.spoken`."""
    return Vocabulary.of(rig).spoken


def _words(name: str) -> tuple[str, ...]:
    return tuple(folded(name).split("_"))


def _means_something(phrase: tuple[str, ...]) -> bool:
    """Whether a phrase has a meaning in some language at every rig, so that a rig's name of it is no name."""
    meanings = [lexicon(language).meanings.get(phrase) for language in LANGUAGES]
    return any(found is not None and all(kind != "!" for kind, _ in found) for found in meanings)


def _is_noun(phrase: tuple[str, ...]) -> bool:
    """Whether it is a general word for a quantity."""
    return any(lexicon(each).meanings.get(phrase, ((" ", ""),))[0][0] in "Kakfq" for each in LANGUAGES)


def meant(word: str, known: Iterable[str]) -> tuple[str, ...]:
    """The known words that a word in small letters may be a slip of, the nearest ones only. One letter more, less or
    other, or two of them swapped, in words of more than SHORTEST letters, and none other in those; two such in words of
    LONG ones; in shorter words only two letters that are swapped.
    """
    found: dict[int, list[str]] = {}
    letters = set(word)
    swapped = [each for each in known if len(each) == len(word) < SHORTEST and sorted(each) == sorted(word)]
    if len(swapped) == 1 and slips(word, swapped[0], 1) == 1:
        return tuple(swapped)
    for each in known:
        most = 2 if len(each) >= LONG else 1
        if len(each) == SHORTEST and len(word) == SHORTEST and sorted(each) != sorted(word):
            continue  # another letter makes another word of so short a one
        if len(each) < SHORTEST or abs(len(each) - len(word)) > most:
            continue
        if len(letters.symmetric_difference(each)) <= 2 * most:  # a slip changes two letters at most
            distance = slips(word, each, most)
            if distance <= most:
                found.setdefault(distance, []).append(each)
    return tuple(sorted(found[min(found)])) if found else ()


def slips(word: str, other: str, most: int) -> int:
    """Typing slips between two words: letters added, left out, exchanged, and neighbours swapped (the optimal string
    alignment of Damerau 1964); ``most`` + 1 where there are more.
    """
    before: list[int] = []
    row = list(range(len(other) + 1))
    for i, letter in enumerate(word, 1):
        older, before, row = before, row, [i]
        for j, wanted in enumerate(other, 1):
            best = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != wanted))
            if older and j > 1 and letter == other[j - 2] and word[i - 2] == wanted:
                best = min(best, older[j - 2] + 1)
            row.append(best)
        if min(row) > most:
            return most + 1
    return row[-1]
