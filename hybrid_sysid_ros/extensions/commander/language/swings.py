"""Swings: what a clause about sines, square waves, triangles and chirps asks for."""

from __future__ import annotations

from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import ENDS, IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import Swing
from hybrid_sysid_ros.extensions.commander.language.values import SHORTEST, Values
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, TIME
from hybrid_sysid_ros.support.errors import UserError

SIZES = ("amplitude", "peak_to_peak")
PERIODS = 10
"""Of a swing that nobody says a length of, or as many as fit into MOST_SECONDS."""
MOST_SECONDS = 500.0
CHIRP_SECONDS = 20.0
"""Of a chirp that nobody says a length of."""
SHAPES = {
    "swing": "sine",
    "chirp": "sine",
    "square": "square",
    "toggle": "square",
    "step": "square",
    "triangle": "triangle",
}


class SwingMeaning:
    """Takes what a swing can take from a clause."""

    def __init__(self, values: Values, verb: str) -> None:
        self.values, self.verb = values, verb
        self.shape = SHAPES[verb]

    def command(self) -> Swing:
        values = self.values
        each = values.clause.each
        if each is not None and len({symbol.value for symbol in values.clause.directions}) > 1:
            raise UserError(f"{each.text!r}: each way, or there and back? say 'with a period of' how long")
        first, last = self.frequencies()
        low, high, output, relative = self.range()
        values.clause.targets = [k for k in values.clause.targets if k != output]
        if values.clause.targets:
            raise UserError(f"{self.verb} moves one output: leave out all but one")
        count = values.take(lambda item: item.base == COUNT) or values.rounds()
        seconds = values.seconds("for", "in", "")
        if count is not None and seconds is not None:
            raise UserError("a time and a count contradict one another: leave one out")
        if self.verb == "chirp":
            if count is not None:
                raise UserError("a chirp has no count: say for how many seconds")
            length = CHIRP_SECONDS if seconds is None else seconds
        else:
            periods = max(1, min(PERIODS, int(MOST_SECONDS * first))) if count is None else count.value
            length = periods / first if seconds is None else seconds
        if length < SHORTEST:
            raise UserError(f"{length:.3g} s are no swing: give {SHORTEST:g} s or more")
        return Swing(
            output=output, low=low, high=high, frequency=first, last_frequency=last, seconds=length, shape=self.shape,
            relative=relative, pace="slowly" if values.pace == "slowly" else "",
        )  # fmt: skip

    def frequencies(self) -> tuple[float, float | None]:
        """The first and, of a chirp, the last one [Hz]."""
        values = self.values
        if self.verb == "chirp":
            ends = [item for item in values.left if item.role in ENDS and FREQUENCY in self.bases(item)]
            if len(ends) != 2:
                raise UserError(
                    "chirp over which frequencies? say 'chirp from 0.1 to 2 Hz with an amplitude of 1 for 20 s'"
                )
            for item in ends:
                values.left.remove(item)
            first, last = (item.value if item.unit is None else item.said for item in ends)
            if ends[0].unit is None and ends[1].unit is not None:
                first = replace(ends[0], unit=ends[1].unit).said
            if first == last:
                raise UserError("both frequencies are the same: say swing")
            return self.above_zero(first), self.above_zero(last)
        frequency = values.take(lambda item: item.base == FREQUENCY and item.kind in ("", "frequency"))
        if frequency is None and (often := self.often()):
            return often, None
        each = values.clause.each
        counted = any(item.base == COUNT for item in values.left)
        if each is not None and each.base == TIME and (self.shape == "square" or counted):
            values.clause.each = None  # "between 4 and 6 m, 5 s each", "3 cycles, 5 s each"
            return self.above_zero((1.0 if counted else 0.5) / values.time(each)), None
        period = values.take(lambda item: item.kind == "period")
        every = values.seconds("every")
        if sum(given is not None for given in (frequency, period, every)) > 1:
            raise UserError("a frequency and a period contradict one another: leave one out")
        if frequency is not None:
            return self.above_zero(frequency.said), None
        if period is not None:
            if period.base != TIME:
                raise UserError(f"{period.text!r}: a period is a time, as in 'with a period of 4 s'")
            return self.above_zero(1.0 / values.time(period)), None
        if every and self.verb == "toggle":
            raise UserError(
                f"every {every:g} s: from one to the other, or there and back? say 'with a period of {2 * every:g} s', "
                f"or 'of {every:g} s'"
            )
        if every:
            return 1.0 / ((2.0 if self.verb == "step" else 1.0) * every), None
        raise IncompleteError(f"{self.verb} how often? say 'at 0.2 Hz' or 'every 5 s'")

    def often(self) -> float:
        """The frequency of "5 times in 20 s" [Hz], 0 where that was not said; the time is left."""
        count = [item for item in self.values.left if item.base == COUNT]
        single = [item for item in count if item.value == 1.0]
        if another := len(count) == 2 and len(single) == 1:  # "one cycle in 4 s, three cycles"
            count = single
        within = [item for item in self.values.left if item.base == TIME and item.role == "in"]
        if (
            len(count) != 1
            or len(within) != 1
            or any(item.role == "every" or item.kind in ("frequency", "period") for item in self.values.left)
        ):
            return 0.0
        self.values.left.remove(count[0])
        if another:
            self.values.left.remove(within[0])
        return self.above_zero(count[0].value / self.values.time(within[0]))

    def bases(self, item: Quantity) -> set[str]:
        """Of a quantity's unit, or of its pair's, which may stand for both."""
        paired = [each.base for each in self.values.left if each.text == item.text]
        return {*paired}

    def above_zero(self, hertz: float) -> float:
        if hertz <= 0.0:
            raise UserError(f"{hertz:g} Hz is no frequency: give one above 0")
        return hertz

    def range(self) -> tuple[float, float, int, bool]:
        """Between which values of which output, and whether they count from where it is."""
        values = self.values
        ends = [item for item in values.left if item.role in (*ENDS, "from", "to") and item.kind != "amplitude"]
        bare = [
            item for item in values.left if item.role in ("", "at") and self.is_span(item) and item.kind not in SIZES
        ]
        ways = {symbol.value for symbol in values.clause.directions}
        if not ends and len(bare) == 2 and ways == {1.0, -1.0} and bare[0].value == bare[1].value > 0.0:
            values.left = [item for item in values.left if item not in bare]  # "two degrees up and two down"
            values.clause.directions = []
            return self.about(replace(bare[0], role="plus_minus"), None)
        places = [values.clause.quantities.index(item) for item in bare if item in values.clause.quantities]
        side_by_side = len(places) == 2 and places[1] - places[0] == 1
        ends = bare if not ends and side_by_side else ends  # "square wave, 0 and 3 m"
        if values.clause.whole_range and not ends and not bare:
            return self.over_all()
        centre, span = values.one("around"), None
        if not ends:
            span = values.take(self.is_span)
        if span is not None:
            return self.about(span, centre)
        if len(ends) != 2 or centre is not None:
            raise IncompleteError(f"{self.verb} between what? say 'between -1 and 1 {values.example}'")
        for item in ends:
            values.left.remove(item)
        first, last = ends
        if first.unit is None and first.value != 0.0:
            first = replace(first, unit=last.unit)
        output = values.output(first if first.unit is not None else last)
        return values.value(first, output), values.value(last, output), output, False

    def over_all(self) -> tuple[float, float, int, bool]:
        """The whole range of the output that is named, or of the only one."""
        clause = self.values.clause
        moving = [k for k in self.values.vocabulary.tracked if self.values.vocabulary.outputs[k].moves]
        chosen = clause.targets or moving
        if len(chosen) != 1:
            raise UserError(f"{clause.whole_range!r} of which output? name one of {self.values.vocabulary.steered}")
        clause.whole_range, shown = "", self.values.vocabulary.outputs[chosen[0]]
        return shown.low, shown.high, chosen[0], False

    def is_span(self, item: Quantity) -> bool:
        return item.kind in SIZES or (
            item.role in ("by", "plus_minus", "at", "") and item.base not in (TIME, FREQUENCY, COUNT)
        )

    def about(self, span: Quantity, centre: Quantity | None) -> tuple[float, float, int, bool]:
        """Around a centre, 0 by default, or around where it is after "by"."""
        values = self.values
        target = values.clause.targets
        if span.output is None and len(target) == 1:
            span = replace(span, output=target[0])
        output = values.output(span)
        here, values.clause.here = values.clause.here, ""
        middle = 0.0 if centre is None else values.value(centre, output)
        most = abs(values.value(span, output, relative=True)) * (0.5 if span.kind == "peak_to_peak" else 1.0)
        return middle - most, middle + most, output, centre is None and (span.role == "by" or bool(here))
