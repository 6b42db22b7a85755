"""Values: quantities of a clause in the units of the outputs that they are of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, IncompleteError, Quantity, Share
from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME, Unit, named, of_rig
from hybrid_sysid_ros.runtime.set_points import SetPointRange
from hybrid_sysid_ros.support.errors import UserError

SHORTEST = 1e-3
"""Seconds that are told apart."""


class Values:
    """The quantities of one clause, and what is left of them."""

    def __init__(self, clause: Clause, vocabulary: Vocabulary) -> None:
        self.clause, self.vocabulary = clause, vocabulary
        self.left = list(clause.quantities)

    @property
    def roles(self) -> set[str]:
        """Of what is left."""
        return {item.role for item in self.left} | {share.role for share in self.clause.shares}

    @property
    def pace(self) -> str:
        return self.clause.paces[0] if self.clause.paces else ""

    @property
    def example(self) -> str:
        """A unit of this rig."""
        return self.vocabulary.outputs[self.vocabulary.tracked[0]].unit if self.vocabulary.tracked else ""

    def take(self, condition: Callable[[Quantity], bool]) -> Quantity | None:
        """The one quantity of a kind, which is then used. Raises UserError for two."""
        found = [item for item in self.left if condition(item)]
        if len(found) > 1:
            raise IncompleteError(
                f"{described(found[0])} and {described(found[1])} contradict one another: leave one out"
            )
        for item in found:
            self.left.remove(item)
        return found[0] if found else None

    def rounds(self) -> Quantity | None:
        """The two of "twice" or three of "three times", which are taken; None where neither was said."""
        said = [share for share in self.clause.shares if share.factor in (2.0, 3.0) and not share.of and not share.role]
        self.clause.shares = [share for share in self.clause.shares if share not in said]
        return Quantity(value=said[0].factor, unit=named("times"), role="", text=said[0].text) if said else None

    def one(self, role: str) -> Quantity | None:
        return self.take(lambda item: item.role == role)

    def seconds(self, *roles: str) -> float | None:
        """A time [s] after one of these words."""
        for item in self.left:
            if item.role in roles and item.role in ("for", "in", "within", "every") and item.unit is None:
                raise UserError(f"{item.role} {item.value:g} of what? say for example '{item.role} {item.value:g} s'")
        found = self.take(lambda item: item.role in roles and item.base == TIME and item.kind != "period")
        return None if found is None else self.time(found)

    def moving_time(self) -> float | None:
        """How long a motion takes [s]. Raises UserError beside "quickly"; "slowly" it may be, which the plan knows."""
        seconds = self.seconds("in", "within")
        if self.pace == "quickly" and seconds:
            raise UserError("quickly and a time contradict one another: leave one out")
        return seconds

    def time(self, item: Quantity) -> float:
        if item.said < SHORTEST:
            raise UserError(f"{described(item)} is no time to plan with: give {SHORTEST:g} s or more")
        return item.said

    def delay(self) -> float:
        """Of the clause [s]."""
        delay = self.clause.delay
        if delay is None or delay.base != TIME:
            raise UserError(f"{delay.text if delay else 'this'!r} is no time: say for example 'in 5 s'")
        return self.time(delay)

    @property
    def rates(self) -> list[Unit]:
        """Of all units in which outputs may be given."""
        return [unit.rate for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k)]

    def part_rate(self) -> None:
        """Of "5 deg/s up to 30 deg" the first value says how fast."""
        own = [unit for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k)]
        for k, item in enumerate(self.left[:-1]):
            unit = item.unit
            if item.role != "span" or self.left[k + 1].role != "span" or unit is None or any(map(unit.alike, own)):
                continue
            if any(map(unit.alike, self.rates)):
                self.left[k : k + 2] = [replace(item, role="at"), replace(self.left[k + 1], role="to")]

    def is_rate(self, item: Quantity) -> bool:
        """Whether a quantity is some output's unit a second, beside a goal of that output."""
        if item.unit is None or item.unit.base in (TIME, FREQUENCY, COUNT):
            return False
        goals = [each for each in self.left if each is not item and each.role in ("", "to", "by")] or self.clause.shares
        units = [unit for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k)]
        if not goals or not any(map(item.unit.alike, self.rates)):
            return False
        if self.clause.directions and self.of_one(goals, item):  # "climb to 300 m at 2 m/s"
            return True
        if any(item.unit.alike(unit) for unit in units):
            raise UserError(
                f"{item.text!r}: how fast, or a value of its own? say 'in' how many seconds, or 'and to' a value"
            )
        return True

    def only_a_rate(self, item: Quantity) -> bool:
        """Whether a bare value measures no output, as in "up 1 rad/s until 3 rad"."""
        own = [unit for k in self.vocabulary.tracked for unit in self.vocabulary.units_of(k)]
        return item.role == "" and "to" in self.roles and not (item.unit and any(map(item.unit.alike, own)))

    def of_one(self, goals: Sequence[Quantity | Share], rate: Quantity) -> bool:
        """Whether all goals are of one output that was named, and this is a rate of it."""
        named = {self.measured(goal) for goal in goals if isinstance(goal, Quantity)} - {None}
        own = [unit.rate for k in named for unit in self.vocabulary.units_of(k)]  # type: ignore[arg-type]  # no None
        at = folded(rate.text).split()[0] in ("at", "a")  # "with 2 m/s" may be a value of its own
        return at and len(named) == 1 and rate.unit is not None and any(map(rate.unit.alike, own))

    def output(self, item: Quantity) -> int:
        """Which output a quantity is of. Raises UserError where that is not certain."""
        if (found := self.measured(item)) is None:
            raise UserError(f"{described(item)} of which output? name one of {self.vocabulary.steered}")
        return found

    def measured(self, item: Quantity) -> int | None:
        """The output that a quantity is of: as it was named, or the only one that has such a unit."""
        tracked, unit = self.vocabulary.tracked, item.unit
        if item.output is not None or len(tracked) == 1:
            return tracked[0] if item.output is None else item.output
        alike = [k for k in tracked if unit and any(unit.alike(other) for other in self.vocabulary.units_of(k))]
        return alike[0] if len(alike) == 1 else None

    def value(self, item: Quantity, output: int, relative: bool = False) -> float:
        """A value of an output, as it is shown. Raises UserError for a unit that measures something else, or none."""
        shown = self.vocabulary.outputs[output]
        if item.unit is None:
            if item.value == 0.0 or not shown.unit or shown.unit == "1":
                return item.value
            if not relative and (in_all := self.counted(item.value, shown)) != item.value:
                return in_all  # a height of 33600 can be nothing else
            raise UserError(f"{item.value:g} of what? say {self.readings(item, output)}")
        if item.unit.base == PERCENT:
            if relative:
                return 0.01 * item.value * 0.5 * (shown.high - shown.low)
            return 0.01 * abs(item.value) * (shown.low if item.value < 0.0 else shown.high)
        return self.shown(item, shown) if relative else self.counted(self.shown(item, shown), shown)

    def readings(self, item: Quantity, output: int) -> str:
        """What a number without a unit could be."""
        travels = self.vocabulary.si(self.vocabulary.outputs[output])
        units = [self.vocabulary.outputs[output].unit]
        units += [] if self.vocabulary.only_unit(output) else [{"rad": "deg"}.get(travels, travels)]
        said = [f"'{item.value:g} {unit}'" for unit in units]
        held = item.role == "" and any(symbol.value == "hold" for symbol in self.clause.verbs)
        return " or ".join([*said, *([f"'for {item.value:g} s'"] if held else [])])

    def counted(self, value: float, output: SetPointRange) -> float:
        """A value from the operating point: one that is in reach only in all counts in all."""
        rest = self.vocabulary.rig.system.operating_point.get(output.name, 0.0) / output.scale
        in_all = not output.low <= value <= output.high and output.low <= value - rest <= output.high
        return value - rest if in_all else value

    def refuse_rate(self, item: Quantity, output: int) -> None:
        """Raise UserError for a rate where a value is asked for."""
        units = self.vocabulary.units_of(output)
        is_rate = item.unit and any(map(item.unit.alike, (unit.rate for unit in units)))
        if is_rate and item.role != "to" and item.output is None:
            unit = self.vocabulary.outputs[output].unit
            raise UserError(f"{item.text!r} says how fast: say how far, too, as in 'by 1 {unit} at 1 {unit}/s'")

    def shown(self, item: Quantity, output: SetPointRange, *, per: int = 0) -> float:
        """A quantity in the output's shown unit, or that a second."""
        if item.unit is None:
            raise UserError(f"{item.value:g} of what? say '{item.value:g} {output.unit}{'/s' * per}'")
        own, si = of_rig(output.unit), of_rig(self.vocabulary.si(output))
        own, si = (unit._replace(per=unit.per + per) for unit in (own, si))
        if item.unit.alike(own):
            return item.said / own.factor
        if item.unit.alike(si):
            return item.said * si.factor / output.scale
        raise UserError(f"{item.text!r} is no {output.name}: say it in {output.unit}{'/s' * per}")


def described(item: Quantity) -> str:
    """A quantity as it was understood."""
    if item.unit is None:
        return f"{item.value:g}"
    if item.unit.base == PERCENT:
        return f"{item.value:g} %"
    return f"{item.said:.4g} {item.unit.base}{('', '/s', '/s^2')[min(item.unit.per, 2)]}"
