"""Shared units: a number without one has that of the values beside it, where these leave no doubt."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, Quantity
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.parts import SWUNG, is_level
from hybrid_sysid_ros.extensions.commander.language.swings import SIZES
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import TIME, Unit

LEADING = SWUNG | {"go", "step", "ramp", "back", "follow"}
"""Verbs beside which a bare number is a value: "a sine about 8 m, 2 either way"."""
LEVELS = ("to", "by", "from", "around", "plus_minus", "between", "range", "span")
"""Roles of values that are no times and no rates."""


def with_units_of_lists(found: Sequence[Symbol]) -> list[Symbol]:
    """Symbols in which the numbers of a list have the unit of its last one, as in "50, 100 and 150 rpm"."""
    made, unit, joined = list(found), None, re.search("Q,Q,Q", "".join(symbol.kind for symbol in found)) is not None
    long = joined  # "50, 100, 150 rpm"
    for k in range(len(made) - 1, -1, -1):
        symbol = made[k]
        if symbol.kind == "Q":
            value, own = symbol.value
            if own is None and unit is not None and joined:
                made[k] = symbol._replace(value=(value, unit))
            else:
                unit, joined = own if is_level(symbol) else None, long
        elif symbol.kind == "j" or (symbol.value == "then" and k + 1 < len(made) and made[k + 1].kind == "Q"):
            joined = True
        elif symbol.kind != ",":
            unit, joined = None, long
    return made


def share_units(clauses: Sequence[Clause], vocabulary: Vocabulary) -> None:
    """Give values without a unit that of their own clause, of the one before, "30 rpm, then 50", or else of the next
    one that has any: "to 30, then 50 rpm".
    """
    spoken = [_spoken(clause, vocabulary) for clause in clauses]
    last = next((said[0].unit for said in spoken if said), None)
    several = len([k for k in vocabulary.tracked if vocabulary.outputs[k].moves]) > 1
    time, verbs = None, list[str]()
    for clause, said in zip(clauses, spoken, strict=True):
        last = said[-1].unit if said else last
        time = _with_times(clause, time)
        if (
            several
            and clause.verbs
            and [verb.text for verb in clause.verbs] != verbs
            and not (clause.targets or clause.directions or said)
        ):
            last = None  # "turn 60 degrees, then drive at 0.2"
        verbs = [verb.text for verb in clause.verbs]
        rates = [unit for item in clause.quantities for unit in _of_rate(item, vocabulary)]
        unit = last if said or not rates else rates[0]
        clause.quantities = [
            replace(item, unit=unit) if unit is not None and _lacks(item, clause, unit, vocabulary) else item
            for item in clause.quantities
        ]
        rise = clause.increment
        if rise is not None and rise.unit is None and unit is not None and any(map(unit.alike, _own(rise, vocabulary))):
            clause.increment = replace(rise, unit=unit)


def _with_times(clause: Clause, time: Unit | None) -> Unit | None:
    """The last unit of time that was said, which times without one have: "for 8 s, ... for another 8"."""
    if clause.delay is not None and clause.delay.base == TIME:
        time = clause.delay.unit
    for k, item in enumerate(clause.quantities):
        waits = item.role == "" and {verb.value for verb in clause.verbs} == {"wait"}
        if item.unit is None and item.value and time is not None and (item.role in ("for", "within") or waits):
            clause.quantities[k] = replace(item, unit=time)
        elif item.base == TIME and item.unit is not None:
            time = item.unit
    return time


def _spoken(clause: Clause, vocabulary: Vocabulary) -> Sequence[Quantity]:
    """Values of a clause that have the unit of their output."""
    awaited = [clause.condition.value] if clause.condition is not None and clause.condition.value else []
    return [item for item in [*awaited, *clause.quantities] if _measures(item, vocabulary)]


def _own(item: Quantity, vocabulary: Vocabulary) -> Sequence[Unit]:
    """Units of the output that a value is of, or of all where that is not known."""
    outputs = vocabulary.tracked if item.output is None else (item.output,)
    return [unit for k in outputs for unit in vocabulary.units_of(k)]


def _measures(item: Quantity, vocabulary: Vocabulary) -> bool:
    """Whether a value has the unit of its output."""
    return item.unit is not None and any(map(item.unit.alike, _own(item, vocabulary)))


def _of_rate(item: Quantity, vocabulary: Vocabulary) -> Sequence[Unit]:
    """The unit whose rate a value has, as in "to 15 at 1 rad/s per second"."""
    return [unit for unit in _own(item, vocabulary) if unit.rate == item.unit]


def _lacks(item: Quantity, clause: Clause, unit: Unit, vocabulary: Vocabulary) -> bool:
    """Whether a value needs a unit, and this one measures its output. Of a pair one may stand for both."""
    goes_on = item.role == "" and clause.then and not clause.verbs
    paired = any(other.unit is not None and other.text == item.text for other in clause.quantities)
    verbs = {symbol.value for symbol in clause.verbs}
    alone = verbs & SWUNG or not any(other.role == "to" for other in clause.quantities)
    leads = bool(clause.directions) or (alone and (clause.wish or verbs & LEADING))
    change = item.role in ("", "at") and bool(leads)
    level = item.kind in SIZES or (
        item.kind not in ("frequency", "period") and (item.role in LEVELS or goes_on or change)
    )
    return (
        item.unit is None
        and item.value != 0.0
        and level
        and not paired
        and any(map(unit.alike, _own(item, vocabulary)))
    )
