"""Grammar: from the clauses of a sentence to commands. What a clause says and its verb can't take is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language import vocabulary as words
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Follow,
    Goal,
    Home,
    Move,
    PictureTarget,
    Repeat,
    Sentence,
    Swing,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.files import Files, is_picture
from hybrid_sysid_ros.extensions.commander.language.sentence import Clause, Quantity, clauses
from hybrid_sysid_ros.extensions.commander.language.stops import EMERGENCY, stop_in
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME, Unit, of_rig
from hybrid_sysid_ros.runtime.configuration import SetPointRange
from hybrid_sysid_ros.support.errors import UserError

PERIODS = 10
"""Of a swing that nobody says a length of."""
SHORTEST = 1e-3
"""Seconds that are told apart."""


def read(text: str, vocabulary: Vocabulary, files: Files | None = None) -> Sentence:
    """The commands of a sentence; files: those that it may follow. A text that says stop and is not understood is a
    stop, and one that speaks of an emergency is one whatever else it says. Raises UserError for any other that is not
    understood, in a line that says what to write instead.
    """
    said = stop_in(text)
    if said == EMERGENCY:
        return Sentence(text=text, commands=(), stops=True, emergency=True)
    try:
        found = clauses(text, vocabulary)
        if found[0].verbs and found[0].verbs[0] == words.STOP:
            return Sentence(text=text, commands=(), stops=True)
        stops = words.STOP in found[-1].verbs
        if any(words.STOP in clause.verbs for clause in found[:-1]):
            raise UserError("'stop' works at once: let it stand alone, or at the end")
        rest = found[:-1] if stops else found
        commands = tuple(_Reader(clause, vocabulary, files or Files()).command() for clause in rest)
    except UserError:
        if said:
            return Sentence(text=text, commands=(), stops=True)
        raise
    return Sentence(text=text, commands=commands, stops=stops)


class _Reader:
    """Takes the quantities of one clause, each for what it can be; what is left at the end is refused."""

    def __init__(self, clause: Clause, vocabulary: Vocabulary, files: Files) -> None:
        self.clause, self.vocabulary, self.files = clause, vocabulary, files
        self.left = list(clause.quantities)
        self.verb = self._verb()
        if len(set(clause.paces)) > 1:
            raise UserError(f"{' and '.join(clause.paces)} contradict one another: leave one out")
        if len(set(clause.directions)) > 1:
            raise UserError("up and down contradict one another: leave one out")

    def _verb(self) -> str:
        found = list(dict.fromkeys(self.clause.verbs))
        if words.REPEAT in found and len(found) > 1:
            found = [verb for verb in found if verb != words.REPEAT] if self.left else [words.REPEAT]
        if words.HOME in found and words.GO in found:
            found.remove(words.GO)
        if words.SWING in found and words.GO in found:
            found.remove(words.GO)
        if not found and self.clause.directions:
            found = [words.GO]
        if not found and self.clause.names:
            found = [words.LOOK if is_picture(self.clause.names[0]) else words.FOLLOW]
        if len(found) > 1:
            raise UserError(f"{found[0]} and {found[1]} in one part: join them by 'then'")
        if not found:
            raise UserError(f"no verb: begin with one of {', '.join(dict.fromkeys(words.VERBS.values()))}")
        return found[0]

    def command(self) -> Command:
        """What the clause asks for."""
        makers: Mapping[str, Callable[[], Command]] = {
            words.HOME: self.home, words.REPEAT: Repeat, words.WAIT: self.wait, words.FOLLOW: self.follow,
            words.LOOK: self.look,
            words.SWING: self.swing, words.STEP: self.step, words.HOLD: self.hold,
            words.GO: lambda: self.move("smooth"), words.RAMP: lambda: self.move("straight"),
        }  # fmt: skip
        made = makers[self.verb]()
        if self.left:
            raise UserError(f"{self.verb} does not take {_described(self.left[0])} here: leave it out")
        if self.clause.names:
            name = self.clause.names[0]
            raise UserError(f"{self.verb} takes no file: say {'look like' if is_picture(name) else 'follow'} {name}")
        if self.clause.paces and not getattr(made, "pace", ""):
            raise UserError(f"{self.verb} can't be {self.clause.paces[0]} here: give its time or frequency alone")
        return made

    def home(self) -> Command:
        return Home(pace=self.pace)

    def wait(self) -> Command:
        seconds = self.seconds("", words.FOR, words.AT, words.IN)
        if seconds is None:
            raise UserError("wait for how long? say for example 'wait 2 s'")
        return Wait(seconds=seconds)

    def follow(self) -> Command:
        names = self.clause.names
        if len(names) != 1:
            own = ", ".join(self.vocabulary.rig.references) or "none"
            raise UserError(f"follow what? name one file of columns (FILE.csv), or a reference of the rig: {own}")
        name = names.pop()
        return Follow(name=name, path=None if name in self.vocabulary.rig.references else self.files.find(name))

    def look(self) -> Command:
        names = self.clause.names
        if len(names) != 1 or not is_picture(names[0]):
            raise UserError("look like what? name one picture, as in 'look like goal.jpg'")
        seconds, hold = self.seconds(words.IN), self.seconds(words.FOR)
        if self.pace and seconds:
            raise UserError(f"{self.pace} and a time contradict one another: leave one out")
        name = names.pop()
        return PictureTarget(name=name, path=self.files.find(name), pace=self.pace, seconds=seconds, hold=hold or 0.0)

    def hold(self) -> Command:
        seconds = self.seconds(words.FOR)
        if not self.left and self.clause.outputs == []:
            return Wait(seconds=seconds or 0.0)
        times = [item for item in self.left if self.base(item) == TIME and item.role != words.IN]
        if times:
            raise UserError(
                f"hold {_described(times[0])} is a time: say 'hold for {_described(times[0])}', or where to hold"
            )
        return replace(self.move("smooth"), hold=seconds or 0.0)

    def move(self, shape: str) -> Move:
        """To one or several goals."""
        begin = self.one(words.FROM)
        seconds = self.seconds(words.IN)
        hold = self.seconds(words.FOR)
        rate = self.take(lambda item: item.role == words.AT and self.is_rate(item))
        paces = [given for given in (self.pace, seconds and "a time", rate and "a rate") if given]
        if len(paces) > 1:
            raise UserError(f"{paces[0]} and {paces[1]} contradict one another: leave one out")
        shared = [item.unit for item in self.left if item.role == words.TO]
        if begin is not None and begin.unit is None and shared:
            begin = replace(begin, unit=shared[0])
        goals = self.goals()
        output = self.vocabulary.outputs[goals[0].output]
        return Move(
            goals=goals,
            shape=shape,
            begin=None if begin is None else self.value(begin, goals[0].output),
            pace=self.pace,
            seconds=seconds,
            rate=None if rate is None else abs(self.shown(rate, output, per=1)),
            hold=hold or 0.0,
        )

    def goals(self) -> tuple[Goal, ...]:
        """All values that are left."""
        found, after = [], {words.BY} if self.clause.directions or self.verb == words.GO else set()
        for item in [each for each in self.left if each.role in {"", words.TO, words.AT, *after}]:
            if self.base(item) in (TIME, FREQUENCY, COUNT):
                continue
            self.left.remove(item)
            output = self.output(item)
            relative = item.role == words.BY or (bool(self.clause.directions) and item.role != words.TO)
            sign = self.clause.directions[0] if relative and self.clause.directions else 1.0
            found.append(Goal(output=output, value=sign * self.value(item, output, relative), relative=relative))
        if not found:
            raise UserError(f"{self.verb} to where? say for example '{self.verb} to 1 {self.example}'")
        if len({goal.output for goal in found}) < len(found):
            raise UserError(f"{self.verb} has several values of one output: join them by 'then'")
        return tuple(found)

    def swing(self) -> Swing:
        return self._swing(square=False)

    def step(self) -> Command:
        pairs = [item for item in self.left if item.role == words.BETWEEN]
        return self._swing(square=True) if pairs else self.move("step")

    def _swing(self, *, square: bool) -> Swing:
        low, high, output, relative = self.range()
        frequency = self.take(lambda item: self.base(item) == FREQUENCY)
        period = self.seconds(words.EVERY, words.AT)
        if frequency is not None and period is not None:
            raise UserError("a frequency and a period contradict one another: leave one out")
        if frequency is not None:
            hertz = frequency.said
        elif period:
            hertz = 1.0 / ((2.0 if square else 1.0) * period)
        else:
            raise UserError(f"{self.verb} how often? say 'at 0.2 Hz' or 'every 5 s'")
        if hertz <= 0.0:
            raise UserError(f"{hertz:g} Hz is no frequency: give one above 0")
        count = self.take(lambda item: self.base(item) == COUNT)
        seconds = self.seconds(words.FOR, words.IN, "")
        if count is not None and seconds is not None:
            raise UserError("a time and a count contradict one another: leave one out")
        periods = PERIODS if count is None else count.value
        length = periods / hertz if seconds is None else seconds
        if length < SHORTEST:
            raise UserError(f"{length:.3g} s are no swing: give {SHORTEST:g} s or more")
        return Swing(
            output=output, low=low, high=high, frequency=hertz, seconds=length, square=square, relative=relative
        )

    def range(self) -> tuple[float, float, int, bool]:
        """Between which values of which output, and whether they count from where it is."""
        ends = [item for item in self.left if item.role in (words.BETWEEN, words.FROM, words.TO)]
        centre, span = self.one(words.AROUND), None
        if not ends:
            span = self.take(
                lambda item: (
                    item.role in (words.BY, words.PLUS_MINUS, words.AT, "")
                    and self.base(item) not in (TIME, FREQUENCY, COUNT)
                )
            )
        if span is not None:
            output = self.output(span)
            middle = 0.0 if centre is None else self.value(centre, output)
            most = abs(self.value(span, output, relative=True))
            return middle - most, middle + most, output, centre is None and span.role == words.BY
        if len(ends) != 2 or centre is not None:
            raise UserError(f"{self.verb} between what? say 'between -1 and 1 {self.example}'")
        for item in ends:
            self.left.remove(item)
        first, last = ends
        if first.unit is None and first.value != 0.0:
            first = replace(first, unit=last.unit)
        output = self.output(first if first.unit is not None else last)
        return self.value(first, output), self.value(last, output), output, False

    @property
    def pace(self) -> str:
        return self.clause.paces[0] if self.clause.paces else ""

    @property
    def example(self) -> str:
        """A unit of this rig."""
        return self.vocabulary.outputs[self.vocabulary.tracked[0]].unit if self.vocabulary.tracked else ""

    def base(self, item: Quantity) -> str:
        return item.unit.base if item.unit is not None else ""

    def take(self, condition: Callable[[Quantity], bool]) -> Quantity | None:
        """The one quantity of a kind, which is then used. Raises UserError for two."""
        found = [item for item in self.left if condition(item)]
        if len(found) > 1:
            raise UserError(f"{_described(found[0])} and {_described(found[1])} contradict one another: leave one out")
        for item in found:
            self.left.remove(item)
        return found[0] if found else None

    def one(self, role: str) -> Quantity | None:
        return self.take(lambda item: item.role == role)

    def seconds(self, *roles: str) -> float | None:
        """A time [s] after one of these words."""
        for item in self.left:
            if item.role in roles and item.role in (words.FOR, words.IN, words.EVERY) and item.unit is None:
                raise UserError(f"{item.role} {item.value:g} of what? say for example '{item.role} {item.value:g} s'")
        found = self.take(lambda item: item.role in roles and self.base(item) == TIME)
        if found is None:
            return None
        if found.said < SHORTEST:
            raise UserError(f"{_described(found)} is no time to plan with: give {SHORTEST:g} s or more")
        return found.said

    def is_rate(self, item: Quantity) -> bool:
        """Whether a quantity is some output's unit a second, and no output's own."""
        if item.unit is None or item.unit.base in (TIME, FREQUENCY, COUNT):
            return False
        goals = [each for each in self.left if each is not item and each.role in ("", words.TO, words.BY)]
        return any(item.unit.alike(unit.rate) for k in self.vocabulary.tracked for unit in self.units(k)) and bool(
            goals
        )

    def units(self, output: int) -> tuple[Unit, ...]:
        """Those in which an output may be told: as it is shown, and as it travels."""
        shown = self.vocabulary.outputs[output]
        return of_rig(shown.unit), of_rig(self.vocabulary.si(shown))

    def output(self, item: Quantity) -> int:
        """Which output a quantity is of: as it was named, or the only one that has such a unit."""
        tracked, outputs = self.vocabulary.tracked, self.vocabulary.outputs
        known = ", ".join(outputs[k].name for k in tracked) or "none"
        if item.output is not None:
            if item.output not in tracked:
                raise UserError(f"{outputs[item.output].name} is not steered by the controller: it tracks {known}")
            return item.output
        if len(tracked) == 1:
            return tracked[0]
        alike = [k for k in tracked if item.unit is not None and any(item.unit.alike(unit) for unit in self.units(k))]
        if len(alike) != 1:
            raise UserError(f"{_described(item)} of which output? name one of {known}")
        return alike[0]

    def value(self, item: Quantity, output: int, relative: bool = False) -> float:
        """A value of an output, as it is shown. Raises UserError for a unit that measures something else, or none."""
        shown = self.vocabulary.outputs[output]
        if item.unit is None:
            return self._bare(item, shown)
        if item.unit.base == PERCENT:
            if relative:
                return 0.01 * item.value * 0.5 * (shown.high - shown.low)
            return 0.01 * abs(item.value) * (shown.low if item.value < 0.0 else shown.high)
        return self.shown(item, shown)

    def _bare(self, item: Quantity, shown: SetPointRange) -> float:
        if item.rate and not of_rig(shown.unit).per:
            speed = f"a speed of {item.value:g} is no {shown.name}"
            raise UserError(f"{speed}, which is in {shown.unit}: say where to, or 'hold'")
        if item.value == 0.0 or not shown.unit or shown.unit == "1":
            return item.value
        raise UserError(f"{item.value:g} of what? {shown.name} is in {shown.unit}: say '{item.value:g} {shown.unit}'")

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
        raise UserError(f"{_described(item)} is no {output.name}: that is in {output.unit}{'/s' * per}")


def _described(item: Quantity) -> str:
    """A quantity as it was understood."""
    if item.unit is None:
        return f"{item.value:g}"
    base = item.unit.base
    if base == PERCENT:
        return f"{item.value:g} %"
    return f"{item.said:.4g} {base}{('', '/s', '/s^2')[min(item.unit.per, 2)]}"
