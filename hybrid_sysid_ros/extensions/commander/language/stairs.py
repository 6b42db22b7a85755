"""Stairs: what a clause about equal steps, each as long as the others, asks for."""

from __future__ import annotations

from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import Staircase
from hybrid_sysid_ros.extensions.commander.language.goals import Goals
from hybrid_sysid_ros.rigs.units import COUNT, TIME
from hybrid_sysid_ros.support.errors import UserError

MOST_STEPS = 100


class StairsMeaning:
    """Takes what a staircase can take from a clause."""

    def __init__(self, values: Goals) -> None:
        self.values, self.clause = values, values.clause

    def command(self) -> Staircase:
        values = self.values
        in_all = self.clause.count_of_steps > 0 and "every" not in values.roles  # "up 2 m in 4 steps"
        toward = values.direction()
        self.part_span(toward)
        seconds, rise, count = self.seconds(), self.rise(), self.count()
        begin, end = self.ends(rise)
        change = values.take(lambda item: item.role in ("", "by") and bool(item.base))
        if rise is None and not in_all:
            rise, change = change, None  # "up 0.5 m every 5 s"
        if change is not None and (end is not None or not toward):
            raise UserError(f"stairs do not take {change.text!r} here: leave it out")
        if rise is None and change is None and end is None:
            raise UserError(f"stairs to where? say 'from 0 to 1 {values.example} in 4 steps of 2 s each'")
        last = end or change
        if rise is None and not count:
            raise UserError("how high is each step? say 'in 4 steps', or 'in steps of' how much")
        if last is None and not count:
            raise UserError("how many steps? say '4 times', or 'up to' where")
        if rise is not None and last is not None and count:
            raise UserError("how many steps, and how high each? leave one out")
        self.clause.directions = []
        if rise is not None and rise.value <= 0.0:
            raise UserError(f"{rise.text!r} is no height of a step: say one above 0, and 'up', 'down', or 'to' where")
        output = values.output(last or rise or begin)  # type: ignore[arg-type]  # one of them was given
        self.clause.targets = [k for k in self.clause.targets if k != output]
        return Staircase(
            output=output, count=count, seconds=seconds, toward=toward, relative=last is not None and last is change,
            begin=None if begin is None else values.value(begin, output),
            end=None if last is None else values.value(last, output, relative=last is change),
            rise=None if rise is None else abs(values.value(rise, output, relative=True)),
        )  # fmt: skip

    def part_span(self, toward: float) -> None:
        """Of "add 30 rpm every 2 s until 180 rpm" the first value is how high each step is."""
        span = [item for item in self.values.left if item.role == "span"]
        if toward and len(span) == 2 and self.clause.increment is None and "every" in self.values.roles:
            first, last = span
            self.values.left = [item for item in self.values.left if item not in span] + [replace(last, role="to")]
            self.clause.increment = first

    def seconds(self) -> float:
        """How long each step lasts [s]."""
        each = self.clause.each
        if each is not None and each.base == TIME:
            self.clause.each = None
            return self.values.time(each)
        found = self.values.seconds("every", "for", "")
        if found is None:
            raise UserError("how long is each step? say 'for 2 s each'")
        return found

    def rise(self) -> Quantity | None:
        """How high each step is."""
        found, self.clause.increment = self.clause.increment, None
        return found

    def count(self) -> int:
        """How many steps there are, 0 where nobody says so."""
        times = self.values.take(lambda item: item.base == COUNT)
        count = self.clause.count_of_steps or (0.0 if times is None else times.value)
        self.clause.count_of_steps = 0
        if not (float(count).is_integer() and 0 <= count <= MOST_STEPS):
            raise UserError(f"{count:g} steps: give a whole number up to {MOST_STEPS}")
        return int(count)

    def ends(self, rise: Quantity | None) -> tuple[Quantity | None, Quantity | None]:
        """From where, and to where; a rise has the unit of both where they have none."""
        found = [item for item in self.values.left if item.role in ("range", "span", "from", "to", "between")]
        for item in found:
            self.values.left.remove(item)
        begins = [item for item in found if item.role == "from"]
        pair = [item for item in found if item.role in ("range", "span", "between")]
        begins, ends = [*begins, *pair[:1]], [*pair[1:], *(item for item in found if item.role == "to")]
        if len(ends) > 1 or len(begins) > 1:
            raise UserError("stairs have one end: say 'from' one value 'to' another")
        begin, end = next(iter(begins), None), next(iter(ends), None)
        unit = next((item.unit for item in (end, rise) if item is not None and item.unit is not None), None)
        begin, end = (replace(item, unit=item.unit or unit) if item else None for item in (begin, end))
        return begin, end
