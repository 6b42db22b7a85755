"""Vocabulary: the words of commands, with those of a rig, and which word a typing slip was meant to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from hybrid_sysid_ros.rigs import units
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import SetPointRange, set_point_ranges

HOLD, GO, STEP, RAMP, SWING, WAIT, FOLLOW, LOOK, REPEAT, HOME, STOP = (
    "hold", "go", "step", "ramp", "swing", "wait", "follow", "look", "repeat", "home", "stop",
)  # fmt: skip
VERBS: Mapping[str, str] = {
    **dict.fromkeys((HOLD, "keep", "stay", "maintain", "remain"), HOLD),
    **dict.fromkeys(
        (
            GO,
            "goto",
            "move",
            "drive",
            "bring",
            "set",
            "turn",
            "put",
            "raise",
            "lower",
            "reach",
            "return",
            "increase",
            "decrease",
        ),
        GO,
    ),
    **dict.fromkeys((STEP, "jump", "steps"), STEP),
    **dict.fromkeys((RAMP, "slide"), RAMP),
    **dict.fromkeys((SWING, "oscillate", "sway", "sine", "swings"), SWING),
    **dict.fromkeys((WAIT, "pause"), WAIT),
    **dict.fromkeys((FOLLOW, "track", "run", "play"), FOLLOW),
    **dict.fromkeys((LOOK, "looks", "match", "resemble"), LOOK),
    **dict.fromkeys((REPEAT, "again", "redo"), REPEAT),
    **dict.fromkeys((HOME, "centre", "center"), HOME),
    **dict.fromkeys((STOP, "halt", "abort", "freeze", "stopp"), STOP),
}
"""What a clause asks for, by the words for it."""
TO, FROM, BETWEEN, BY, AROUND, AT, FOR, IN, EVERY, AND, PLUS_MINUS = (
    "to", "from", "between", "by", "around", "at", "for", "in", "every", "and", "±",
)  # fmt: skip
ROLES: Mapping[str, str] = {
    **{word: word for word in (TO, FROM, BETWEEN, BY, AROUND, AT, FOR, EVERY, AND, PLUS_MINUS)},
    **{"about": AROUND, "with": AT, "+-": PLUS_MINUS},
    **dict.fromkeys((IN, "within", "over", "during", "taking"), IN),
}
"""What the quantity after a word is for."""
PACES: Mapping[str, str] = {
    **dict.fromkeys(("slowly", "slow", "gently", "carefully", "softly"), "slowly"),
    **dict.fromkeys(("quickly", "quick", "fast", "rapidly", "briskly"), "quickly"),
}
DIRECTIONS: Mapping[str, float] = {
    **dict.fromkeys(("up", "raise", "increase", "further", "more"), 1.0),
    **dict.fromkeys(("down", "lower", "decrease", "less"), -1.0),
}
"""Words that make a value without "to" a change of what there is."""
FILLERS = frozenset(
    [
        "please",
        "the",
        "a",
        "an",
        "now",
        "it",
        "rig",
        "of",
        "output",
        "angle",
        "value",
        "position",
        "speed",
        "velocity",
        "frequency",
        "period",
        "amplitude",
        "rate",
        "then",
        "just",
        "your",
        "you",
        "can",
        "could",
        "would",
        "will",
        "my",
        "me",
        "us",
        "let",
        "lets",
        "and",
        "so",
        "ok",
        "okay",
        "hey",
        "experiment",
        "last",
        "same",
        "once",
        "file",
        "like",
        "picture",
        "image",
        "photo",
        "this",
        "that",
        "thanks",
        "thank",
        "exactly",
        "steady",
        "still",
        "here",
        "there",
        "moving",
        "swinging",
        "do",
        "make",
        "start",
        "begin",
        "perform",
        "i",
        "we",
        "want",
        "need",
    ]
)
"""Words that change nothing, where they are no output's name."""
RATES = frozenset(("speed", "velocity", "rate"))
"""Of them, those whose 0 is a standstill and no place."""
REFUSED: Mapping[str, str] = {
    **dict.fromkeys(
        ("not", "no", "never", "don't", "dont", "without", "cannot", "can't", "nothing", "avoid", "except"),
        "commands say what to do, not what to leave: say stop to stop",
    ),
    **dict.fromkeys(
        ("if", "when", "unless", "while", "until", "after", "before", "or", "otherwise", "else"),
        "commands have no conditions: join them by 'then', with times",
    ),
    **dict.fromkeys(("forever", "always", "endlessly"), "a plan has an end: say for how many seconds"),
}
"""Words that would change everything, and the reason."""
THEN = frozenset(("then", "afterwards", "next", "finally"))
NUMBERS: Mapping[str, float] = {
    word: float(value)
    for value, word in enumerate(
        [
            "zero",
            "one",
            "two",
            "three",
            "four",
            "five",
            "six",
            "seven",
            "eight",
            "nine",
            "ten",
            "eleven",
            "twelve",
        ]  # as people spell them out
    )
} | {"half": 0.5}
SIGNS: Mapping[str, float] = {"minus": -1.0, "negative": -1.0, "plus": 1.0}
SHORTEST = 4  # letters of a known word that may be written with a slip
LONG = 7  # letters of one that may be written with two


@dataclass(frozen=True, kw_only=True, eq=False)
class Vocabulary:
    """The words that mean something at a rig."""

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
    def names(self) -> Mapping[str, int]:
        """Outputs by the words for them: their names, with spaces between for "_", and those of joints that carry one
        tracked output each.
        """
        found: dict[str, int] = {}
        for joint in self.rig.joints.joints:
            carried = [k for k in self.tracked if self.rig.joints.place(self.outputs[k].name)[0] == joint]
            if len(carried) == 1:
                found[joint.lower()] = carried[0]
        for k, output in enumerate(self.outputs):
            found[output.name.lower()] = k
        return found

    @cached_property
    def inputs(self) -> frozenset[str]:
        """Names of the inputs, which are the controller's, but those that an output has, too, or that mean nothing."""
        return frozenset(item.name.lower() for item in self.rig.system.inputs) - self.names.keys() - FILLERS

    @cached_property
    def fillers(self) -> frozenset[str]:
        """Those of every rig, and the parts of this one's own name and its joints'."""
        own = {part for name in (self.rig.name, *self.rig.joints.joints) for part in name.lower().split("_")}
        return FILLERS | (own - self.names.keys())

    @cached_property
    def units(self) -> Mapping[str, units.Unit]:
        """All that the table names, and those in which this rig's outputs are shown."""
        own = [text for output in self.outputs for text in (output.unit, self.si(output)) if text]
        return {**units.words(), **{text: units.of_rig(text) for text in own}}

    def si(self, output: SetPointRange) -> str:
        """The unit in which an output travels."""
        return next(item.unit for item in self.rig.system.outputs if item.name == output.name)

    @cached_property
    def _known(self) -> frozenset[str]:
        spelled = {word for word in units.words() if len(word) >= SHORTEST and word.isalpha()}
        meant = {*VERBS, *ROLES, *DIRECTIONS, *PACES, *REFUSED, *THEN, *NUMBERS, *SIGNS, *self.names, *self.fillers}
        return frozenset(meant | spelled | {word.lower() for word in self.units})

    def knows(self, word: str) -> bool:
        """Whether a word in small letters means something as it is."""
        return word in self._known

    def meant(self, word: str) -> tuple[str, ...]:
        """The known words that a word in small letters may be a slip of, the nearest ones only. One letter more, less
        or other, or two of them swapped, in words of SHORTEST letters; two such in words of LONG ones; in shorter words
        only two letters that are swapped.
        """
        found: dict[int, list[str]] = {}
        letters = set(word)
        swapped = [each for each in self._known if len(each) == len(word) < SHORTEST and sorted(each) == sorted(word)]
        if len(swapped) == 1 and slips(word, swapped[0], 1) == 1:
            return tuple(swapped)
        for known in self._known:
            most = 2 if len(known) >= LONG else 1
            if len(known) < SHORTEST or abs(len(known) - len(word)) > most:
                continue
            if len(letters.symmetric_difference(known)) <= 2 * most:  # a slip changes two letters at most
                distance = slips(word, known, most)
                if distance <= most:
                    found.setdefault(distance, []).append(known)
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
