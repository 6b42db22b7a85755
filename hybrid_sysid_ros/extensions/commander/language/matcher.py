"""Matcher: fits patterns to the symbols of a clause. A symbol that no pattern takes is refused by its words."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hybrid_sysid_ros.extensions.commander.language.clauses import MOST, Clause, IncompleteError
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.notes import FilledSlot, Notes, is_time
from hybrid_sysid_ros.extensions.commander.language.parts import SWUNG, in_order
from hybrid_sysid_ros.extensions.commander.language.patterns import PATTERNS
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, TIME, Unit
from hybrid_sysid_ros.support.errors import UserError

GO = Symbol("V", "go", "go")


def clause_of(part: Sequence[Symbol], vocabulary: Vocabulary) -> Clause:
    """What a part says. Raises UserError for what can't be read, in a line that says what to write instead."""
    return _Matcher(part, vocabulary).clause()


def clauses(parts: Sequence[Sequence[Symbol]], vocabulary: Vocabulary) -> list[Clause]:
    """The clauses of a sentence, in the order in which they come."""
    made = [clause_of(part, vocabulary) for part in in_order([[*part] for part in parts])]
    made = _with_paces([clause for clause in made if not clause.empty])
    if not made:
        raise UserError("this asks for nothing: say for example 'go to', 'hold', 'swing between', 'home' or 'stop'")
    if len(made) > MOST:
        raise UserError(f"{len(made)} parts: a command has {MOST} at most; for more, follow a file")
    return made


def _with_paces(found: Sequence[Clause]) -> list[Clause]:
    """Clauses, each with the pace that stands alone behind it, "50 rpm. Slowly.", without a last "go!"."""
    made: list[Clause] = []
    for clause in found:
        if made and clause == Clause(paces=clause.paces) and clause.paces and not made[-1].paces:
            made[-1].paces += clause.paces
        elif not made or [clause.verbs, clause] != [[GO], Clause(verbs=[GO], displacing=clause.displacing)]:
            made.append(clause)
    return made


def _letter(symbol: Symbol) -> str:
    """By which patterns know a symbol: its kind, or what a quantity measures."""
    if symbol.kind != "Q" or symbol.value[1] is None:
        return "9" if symbol.kind == "Q" else symbol.kind
    return {TIME: "1", FREQUENCY: "2", COUNT: "Q"}.get(symbol.value[1].base, "9")


def _own_rate(quantities: Sequence[tuple[float, Unit | None]]) -> bool:
    """Whether the second of two quantities says how fast the first one is gone."""
    if len(quantities) != 2:
        return False
    (_, first), (_, last) = quantities
    return first is not None and last is not None and last.alike(first.rate) and not last.alike(first)


class _Matcher(Notes):
    """Fits patterns to the symbols of one clause."""

    def clause(self) -> Clause:
        letters = "".join(map(_letter, self.part))
        at = 0
        while at < len(letters):
            for slot, pattern in PATTERNS:
                match = pattern.match(letters, at)
                if match and match.end() > at:
                    end = self.end(slot, match)
                    self.note(slot, self.part[at:end], "".join(symbol.kind for symbol in self.part[at:end]))
                    at = end
                    break
            else:
                raise IncompleteError(self.without_meaning(at))
        return self.made

    def end(self, slot: str, match: re.Match[str]) -> int:
        """Where a match ends: a name behind a value is not its own where another one stands before it ("height 300 m,
        speed 10 m/s"). Raises UserError for a condition that would have to last.
        """
        kinds = "".join(symbol.kind for symbol in self.part)
        if slot == "condition" and kinds[match.end() :][:2] in ("RQ", "rQ"):
            raise UserError("how long a condition lasts is not watched: say 'once it is still, wait 5 s, then go to 0'")
        taken = kinds[match.start() : match.end()]
        if not self.waiting or slot == "share" or "Q" not in taken or taken[-1] not in "KO":
            return match.end()
        return match.start() + taken.index("Q") + 1

    def without_meaning(self, at: int) -> str:
        symbol = self.part[at]
        before = " ".join(dict.fromkeys(each.text for each in self.part[max(0, at - 2) : at]))
        where = f"after {before!r}" if before else "at the beginning"
        return f"{symbol.text!r} has no meaning {where}: leave it out, or say for example 'go to 1 {self.example}'"

    def note(self, slot: str, part: Sequence[Symbol], letters: str) -> None:
        """Note what a pattern has found."""
        found = FilledSlot(slot, part, letters, [symbol.value for symbol in part if symbol.kind in "Q^"])
        found = self.resolved(
            found._replace(output=self.named(found.names, needed=slot not in ("rate", "full_speed", "former")))
        )
        getattr(self, f"_note_{found.slot}", self._note_value)(found)

    def resolved(self, found: FilledSlot) -> FilledSlot:
        """With the slot that a Portuguese preposition of several meanings has here."""
        led = any(symbol.value == "to_or_at" for symbol in found.part)
        pair = [*((item.value, item.unit) for item in self.made.quantities), *found.quantities][-2:]
        if led and (self.paces(found.quantities) or _own_rate(pair)):  # "a 2 Hz", "300 m a 5 m/s"
            self.made.quantities += [self.quantity(said, "", found.text) for said in found.quantities[:-1]]
            at = next(k for k, symbol in enumerate(found.part) if symbol.value == "to_or_at")
            return found._replace(slot="rate", quantities=found.quantities[-1:], part=found.part[at:])
        if found.slot not in ("in", "in_or_to", "for_or_by"):
            return found
        unit = found.quantities[0][1]
        if found.slot == "for_or_by":  # "por 2 s", "aumente por 2 m"
            return found._replace(slot="for" if unit is None or unit.base in (TIME, COUNT) else "by")
        if is_time(unit):
            later = found.part[0].value != "over" and self.begins()  # "over 5 s" says how long, wherever it stands
            return found._replace(slot="later" if later else "in")
        if found.slot == "in_or_to":  # "aumente em 2 m"
            if SWUNG & {symbol.value for symbol in self.made.verbs}:  # "oscile em 2 m"
                return found._replace(slot="plain")
            return found._replace(slot="by" if self.made.directions else "plain" if self.made.displacing else "to")
        return found
