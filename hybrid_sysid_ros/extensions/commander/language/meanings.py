"""Meanings: what one clause asks for. Each verb takes what it can; what is left at the end is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language import commands
from hybrid_sysid_ros.extensions.commander.language.clauses import MOST, Clause, IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.files import Files, is_picture
from hybrid_sysid_ros.extensions.commander.language.stairs import StairsMeaning
from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.extensions.commander.language.swings import SwingMeaning
from hybrid_sysid_ros.extensions.commander.language.values import described
from hybrid_sysid_ros.extensions.commander.language.verbs import Verbs
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, TIME
from hybrid_sysid_ros.support.errors import UserError

LASTING = re.compile(r"(?:(?:for|with|com) )?(?:a )?(?:duration|duracao|lasting)\b|(?:of|de)\b")
"""How long a motion itself takes, in small letters."""


class Meaning(Verbs):
    """Takes the quantities of one clause, each for what it can be."""

    def __init__(self, clause: Clause, vocabulary: Vocabulary, files: Files, *, behind: bool = False) -> None:
        """behind: that other commands go before, so that "there" is where they lead."""
        super().__init__(clause, vocabulary)
        self.behind, self.times = behind, 1
        self.files = files
        if clause.at_full_speed:
            led = clause.shares or clause.directions or any(item.base != TIME for item in self.left)
            verbs = {symbol.value for symbol in clause.verbs}
            if led or verbs - {"go", "follow", "hold"} or "for" not in self.roles:
                clause.paces.append("quickly")
            else:
                clause.full_speed = clause.at_full_speed  # "spin at full speed for 5 s"
        if len(set(clause.paces)) > 1:
            raise UserError(f"{' and '.join(clause.paces)} contradict one another: leave one out")
        self.verb = self.chosen()

    def command(self) -> commands.Command:
        """What the clause asks for."""
        makers: Mapping[str, Callable[[], commands.Command]] = {
            "home": self.home, "repeat": self.repeat,
            "undo": self.undo, "stairs": lambda: StairsMeaning(self).command(), "wait": self.wait,
            "follow": self.follow, "look": self.look,
            "swing": self.swing, "square": self.swing, "toggle": self.swing,
            "triangle": self.swing, "chirp": self.swing, "step": self.step,
            "hold": self.hold, "still": self.hold, "go": self.go, "ramp": lambda: self.move("straight"),
        }  # fmt: skip
        made = makers[self.verb]()
        if isinstance(made, commands.Move | commands.Home | commands.Wait | commands.Undo):
            self.times = self.count()
        self.refuse_left(made)
        return made

    def refuse_left(self, made: commands.Command) -> None:
        """Raise UserError for what the clause says and the command did not take."""
        clause = self.clause
        if self.left and self.left[0].base == TIME and self.left[0].role == "" and isinstance(made, commands.Move):
            text, leads = self.left[0].text, clause.quantities[0] is self.left[0]
            doubt = IncompleteError if leads and len(clause.quantities) > 1 else UserError  # "5 s, 20 rpm"
            raise doubt(f"{text!r}: in that time, or for so long? say 'in {text}' or 'for {text}'")
        if self.left:
            raise IncompleteError(f"{self.verb} does not take {described(self.left[0])} here: leave it out")
        if clause.names:
            name = clause.names[0]
            raise UserError(f"{self.verb} takes no file: say {'look like' if is_picture(name) else 'follow'} {name}")
        if clause.paces and not getattr(made, "pace", ""):
            raise UserError(f"{self.verb} can't be {clause.paces[0]} here: give its time or frequency alone")
        said = [share.text for share in clause.shares] + [text for *_, text in clause.comparatives]
        said += [symbol.text for symbol in clause.directions] + clause.nouns
        said += [clause.bit, clause.here, clause.from_home, clause.full_speed]
        said += [clause.sense.text] if clause.sense else []
        said += [clause.together, clause.whole_range, clause.increment.text if clause.increment else ""]
        said += ["smoothly"] if clause.smoothly and getattr(made, "shape", "smooth") != "smooth" else []
        for text in filter(None, said):
            raise IncompleteError(f"{text!r} has no meaning with {self.verb} here: leave it out")
        if (
            isinstance(made, commands.Home | commands.Repeat | commands.Undo | commands.Wait | commands.Follow)
            and clause.targets
        ):
            raise UserError(f"{self.verb} takes no output: leave {self.vocabulary.outputs[clause.targets[0]].name} out")

    def undo(self) -> commands.Undo:
        seconds, toward = self.moving_time(), self.direction()
        outputs, self.clause.targets, self.clause.directions = tuple(self.clause.targets), [], []
        return commands.Undo(pace=self.pace, seconds=seconds, toward=toward, outputs=outputs)

    def repeat(self) -> commands.Command:
        """Once, or so many times, or for so long; behind other commands that could mean these, too."""
        times, seconds = self.count(), self.seconds("for")
        if self.behind:
            raise UserError("repeat these parts, or what was before? say 'repeat' alone, or the parts again")
        return commands.Repeat(pace=self.pace, times=times, seconds=seconds)

    def count(self) -> int:
        """How often. Raises UserError where that is not from 1 to MOST."""
        count, twice = self.take(lambda item: item.base == COUNT), self.rounds()
        times = count.value if count is not None else twice.value if twice is not None else 1.0
        if not (times.is_integer() and 1.0 <= times <= MOST):
            raise UserError(f"{self.verb} {times:g} times: give a whole number from 1 to {MOST}")
        return int(times)

    def home(self) -> commands.Command:
        """All outputs; of some of them, or with a rate, it is a move to 0."""
        moving = [k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves]
        targets = [] if set(moving) <= set(self.clause.targets) else self.clause.targets
        rated = any(any(map(item.unit.alike, self.rates)) for item in self.left if item.unit)
        if targets or rated or self.clause.directions:
            zero = Quantity(value=0.0, unit=None, role="to", text="0")
            self.left += [replace(zero, output=k) for k in targets or moving]
            return self.move("smooth")
        self.clause.targets = []
        seconds, hold = self.moving_time(), self.seconds("for")
        return commands.Home(pace=self.pace, seconds=seconds, hold=hold or 0.0)

    def wait(self) -> commands.Command:
        seconds = self.seconds("", "for", "at", "in")
        if seconds is None:
            raise IncompleteError("wait for how long? say for example 'wait 2 s', or 'hold' to stay here")
        self.clause.here = ""
        return commands.Wait(seconds=seconds)

    def follow(self) -> commands.Command:
        names = self.clause.names
        if len(names) != 1:
            own = ", ".join(self.vocabulary.rig.references) or "none"
            raise UserError(f"follow what? name one file of columns (FILE.csv), or a reference of the rig: {own}")
        name, self.times = names.pop(), self.count()
        return commands.Follow(
            name=name, path=None if name in self.vocabulary.rig.references else self.files.find(name)
        )

    def look(self) -> commands.Command:
        names = self.clause.names
        if len(names) != 1 or not is_picture(names[0]):
            raise UserError("look like what? name one picture, as in 'look like goal.jpg'")
        seconds, hold = self.moving_time(), self.seconds("for")
        name = names.pop()
        return commands.PictureTarget(
            name=name, path=self.files.find(name), pace=self.pace, seconds=seconds, hold=hold or 0.0
        )

    def hold(self) -> commands.Command:
        clause = self.clause
        seconds = self.seconds("for")
        if not self.left and not clause.shares:
            return self.stay(seconds or 0.0)
        if self.verb == "still" and any(item.value and item.base != TIME for item in self.left):
            raise UserError(f"still, and at {described(self.left[0])}? say 'hold' that value, or leave it out")
        if clause.directions:
            raise UserError(f"hold takes no direction: say 'go {clause.directions[0].text}', or where to hold")
        times = [item for item in self.left if item.base == TIME and item.role not in ("in", "within")]
        if times and (self.behind or self.verb == "still") and times == self.left:  # "go to 1 m, hold 2 s"
            self.left = []
            return self.stay(self.time(times[0]))
        if len(times) == 1 and times[0].role == "" and (len(self.left) > 1 or clause.shares):  # "stay at 2 m a minute"
            self.left.remove(times[0])
            seconds = self.time(times[0])
        elif times:
            raise UserError(
                f"hold {described(times[0])} is a time: say 'hold for {described(times[0])}', or where to hold"
            )
        if clause.verbs[0].text == "leave" and any(item.role == "" for item in self.left):
            raise UserError(f"{self.left[0].text!r}: stay there, or away from it? say 'hold' it, or where to go")
        clause.here, made = "", self.move("smooth")
        if clause.going and any(goal.value == 0.0 and not goal.relative for goal in made.goals):
            raise UserError("keep moving, at 0? say 'go to 0', or a value")
        return replace(made, hold=seconds or 0.0)

    def stay(self, seconds: float) -> commands.Command:
        """Where it is. A speed that stays is no standstill, so what is meant is asked."""
        self.clause.here = ""
        rates = [k for k in self.vocabulary.tracked if self.vocabulary.of_kind("speed").count(k)]
        only = len(rates) == len([k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves])
        kept = self.clause.targets
        self.clause.targets = []
        if self.verb == "still" and (moving := self.vocabulary.of_kind("rest")):
            if only and not seconds:
                return commands.Home(pace=self.pace)
            zero = tuple(commands.Goal(output=k, value=0.0) for k in moving)
            return commands.Move(goals=zero, shape="smooth", pace=self.pace, hold=seconds)
        if rates and not seconds and not self.behind and not (kept and set(kept) <= set(rates)) and only:
            name = self.vocabulary.outputs[rates[0]].name
            raise UserError(
                f"do you mean to keep the {name} that it has, or to stand still? say 'keep the speed', or 'go to 0'"
            )
        return commands.Wait(seconds=seconds)

    def step(self) -> commands.Command:
        pairs = [item for item in self.left if item.role == "between"]
        return self.swing() if pairs else self.move("step")

    def swing(self) -> commands.Command:
        return SwingMeaning(self, self.verb).command()

    def move(self, shape: str) -> commands.Move:
        """To one or several goals."""
        begin = self.one("from")
        self.part_rate()
        for item in [each for each in self.left if each.role in ("range", "span")]:
            self.left.remove(item)
            if begin is None:
                begin = item
            else:
                self.left.append(replace(item, role="to"))
        if shape == "straight":  # a ramp lasts as long as it takes
            self.left = [
                replace(item, role="in") if item.base == TIME and LASTING.match(folded(item.text)) else item
                for item in self.left
            ]
        # "slowly, 8 s" can only be how long the motion takes
        seconds = self.seconds("in", "within", *([""] if self.pace == "slowly" else []))
        hold = self.seconds("for")
        led = (
            ("at", "no_faster", "by") if "to" in self.roles else ("at", "no_faster")
        )  # "by 1 m/s each second to 4 m/s"
        rate = self.take(lambda item: (item.role in led or self.only_a_rate(item)) and self.is_rate(item))
        pace = "" if self.pace == "slowly" else self.pace  # which a time or a rate may be: the plan knows
        paces = [given for given in (pace, seconds and "a time", rate and "a rate") if given]
        if len(paces) > 1:
            raise UserError(f"{paces[0]} and {paces[1]} contradict one another: leave one out")
        if shape == "step" and (paces or self.pace) and self.pace != "quickly":
            raise UserError(
                f"a step takes no time, so {self.pace or paces[0]} says nothing: say 'ramp to', or 'in 3 s step to'"
            )
        shared = [item.unit for item in self.left if item.role == "to"]
        if begin is not None and begin.unit is None and shared:
            begin = replace(begin, unit=shared[0])
        if begin is not None and not shared:
            raise UserError(f"from {begin.value:g} to where? say 'from 0 to 1 {self.example}'")
        if hold and self.at_a_rate(hold):  # "climb at 5 m/s for 20 s"
            shape, seconds, hold = "straight", hold, None
        goals = self.goals()
        output = self.vocabulary.outputs[goals[0].output]
        return commands.Move(
            goals=goals, shape=shape, begin=None if begin is None else self.value(begin, goals[0].output),
            pace=self.pace, seconds=seconds, rate=None if rate is None else abs(self.shown(rate, output, per=1)),
            hold=hold or 0.0,
        )  # fmt: skip
