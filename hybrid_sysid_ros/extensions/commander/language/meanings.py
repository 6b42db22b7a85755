"""Meanings: what one clause asks for. Each verb takes what it can; what is left at the end is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import MOST, Clause, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Adjust,
    Command,
    Follow,
    Goal,
    Home,
    Move,
    PictureTarget,
    Repeat,
    Undo,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.files import Files, is_picture
from hybrid_sysid_ros.extensions.commander.language.swings import SwingMeaning
from hybrid_sysid_ros.extensions.commander.language.values import Values, described
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

BIT = 0.05
"""Of half the set-points' range, by which "up a bit" changes them."""


class Meaning(Values):
    """Takes the quantities of one clause, each for what it can be."""

    def __init__(self, clause: Clause, vocabulary: Vocabulary, files: Files, *, behind: bool = False) -> None:
        """behind: that other commands go before, so that "there" is where they lead."""
        super().__init__(clause, vocabulary)
        self.behind = behind
        self.files = files
        if len(set(clause.paces)) > 1:
            raise UserError(f"{' and '.join(clause.paces)} contradict one another: leave one out")
        self.verb = self._verb()

    def _verb(self) -> str:
        clause = self.clause
        found = list(dict.fromkeys(symbol.value for symbol in clause.verbs))
        if "repeat" in found and len(found) > 1 and self.left:
            found.remove("repeat")
        for general in ("go", "step", "ramp"):
            if (
                general in found
                and len(found) > 1
                and set(found) & {"swing", "square", "triangle", "chirp", "home", "undo"}
            ):
                found.remove(general)
        if found in (["go", "step"], ["step", "go"], ["go", "ramp"], ["ramp", "go"]):
            found.remove("go")
        if found == ["follow"] and not clause.names and self.left:
            found = ["go"]  # "run at 100 rpm"
        if not found and clause.names:
            found = ["look" if is_picture(clause.names[0]) else "follow"]
        if not found and (
            clause.directions or clause.comparatives or clause.targets or clause.shares
            or any(item.role in ("to", "range") for item in self.left)
        ):  # fmt: skip
            found = ["go"]
        if len(found) > 1:
            raise UserError(f"{found[0]} and {found[1]} in one part: join them by 'then'")
        if not found and clause.here:
            found = ["hold"]
        if not found:
            raise UserError(
                "no verb: begin with 'go to', 'hold', 'ramp to', 'step to', 'swing', 'wait', 'home' or 'stop'"
            )
        return found[0]

    def command(self) -> Command:
        """What the clause asks for."""
        makers: Mapping[str, Callable[[], Command]] = {
            "home": lambda: Home(pace=self.pace), "repeat": self.repeat,
            "undo": lambda: Undo(pace=self.pace), "wait": self.wait, "follow": self.follow, "look": self.look,
            "swing": self.swing, "square": self.swing, "triangle": self.swing, "chirp": self.swing, "step": self.step,
            "hold": self.hold, "still": self.hold, "go": self.go, "ramp": lambda: self.move("straight"),
        }  # fmt: skip
        made = makers[self.verb]()
        self.refuse_left(made)
        return made

    def refuse_left(self, made: Command) -> None:
        """Raise UserError for what the clause says and the command did not take."""
        clause = self.clause
        if self.left:
            raise UserError(f"{self.verb} does not take {described(self.left[0])} here: leave it out")
        if clause.names:
            name = clause.names[0]
            raise UserError(f"{self.verb} takes no file: say {'look like' if is_picture(name) else 'follow'} {name}")
        if clause.paces and not getattr(made, "pace", ""):
            raise UserError(f"{self.verb} can't be {clause.paces[0]} here: give its time or frequency alone")
        said = [share.text for share in clause.shares] + [text for *_, text in clause.comparatives]
        said += [symbol.text for symbol in clause.directions] + clause.nouns + [clause.bit, clause.here]
        said += ["smoothly"] if clause.smoothly and getattr(made, "shape", "smooth") != "smooth" else []
        for text in filter(None, said):
            raise UserError(f"{text!r} has no meaning with {self.verb} here: leave it out")
        if isinstance(made, Home | Repeat | Undo | Wait | Follow) and clause.targets:
            raise UserError(f"{self.verb} takes no output: leave {self.vocabulary.outputs[clause.targets[0]].name} out")

    def repeat(self) -> Command:
        """Once, or so many times; behind other commands that could mean these, too."""
        count = self.take(lambda item: item.base == COUNT)
        twice = [
            share for share in self.clause.shares if share.factor in (2.0, 3.0) and not share.of and not share.role
        ]
        self.clause.shares = [share for share in self.clause.shares if share not in twice]
        times = count.value if count is not None else twice[0].factor if twice else 1.0
        if self.behind:
            raise UserError(
                "repeat these parts, or what was carried out before? say 'repeat' alone, or the parts again"
            )
        if not (times.is_integer() and 1.0 <= times <= MOST):
            raise UserError(f"repeat {times:g} times: give a whole number from 1 to {MOST}")
        return Repeat(pace=self.pace, times=int(times))

    def wait(self) -> Command:
        seconds = self.seconds("", "for", "at", "in")
        if seconds is None:
            raise UserError("wait for how long? say for example 'wait 2 s', or 'hold' to stay here")
        self.clause.here = ""
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
        seconds, hold = self.seconds("in", "within"), self.seconds("for")
        if self.pace and seconds:
            raise UserError(f"{self.pace} and a time contradict one another: leave one out")
        name = names.pop()
        return PictureTarget(name=name, path=self.files.find(name), pace=self.pace, seconds=seconds, hold=hold or 0.0)

    def hold(self) -> Command:
        clause = self.clause
        seconds = self.seconds("for")
        if not self.left and not clause.shares:
            return self.stay(seconds or 0.0)
        if clause.directions:
            raise UserError(f"hold takes no direction: say 'go {clause.directions[0].text}', or where to hold")
        times = [item for item in self.left if item.base == TIME and item.role not in ("in", "within")]
        if times and self.behind and times == self.left:  # "go to 1 V, hold 2 s"
            self.left = []
            return self.stay(self.time(times[0]))
        if times:
            raise UserError(
                f"hold {described(times[0])} is a time: say 'hold for {described(times[0])}', or where to hold"
            )
        clause.here = ""
        return replace(self.move("smooth"), hold=seconds or 0.0)

    def stay(self, seconds: float) -> Command:
        """Where it is. A speed that stays is no standstill, so what is meant is asked."""
        self.clause.here = ""
        rates = [k for k in self.vocabulary.tracked if self.vocabulary.of_kind("speed").count(k)]
        only = len(rates) == len([k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves])
        kept = self.clause.targets
        self.clause.targets = []
        if self.verb == "still" and only and not seconds:
            return Home(pace=self.pace)
        if rates and not seconds and not self.behind and not (kept and set(kept) <= set(rates)) and only:
            name = self.vocabulary.outputs[rates[0]].name
            raise UserError(
                f"do you mean to keep the {name} that it has, or to stand still? say 'keep the speed', or 'go to 0'"
            )
        return Wait(seconds=seconds)

    def step(self) -> Command:
        pairs = [item for item in self.left if item.role == "between"]
        return self.swing() if pairs else self.move("step")

    def swing(self) -> Command:
        return SwingMeaning(self, self.verb).command()

    def go(self) -> Command:
        clause = self.clause
        if clause.comparatives:
            return self.compared()
        adjusted = clause.nouns or [item.kind for item in self.left if item.kind in ("amplitude", "frequency")]
        return self.adjust(adjusted[0]) if adjusted else self.move("smooth")

    def compared(self) -> Command:
        """What "slower" asks for: of a speed another value, of the last swing another frequency."""
        ((factor, text), *more) = self.clause.comparatives
        if more or self.left or self.clause.shares:
            raise UserError(f"{text!r} by how much? say it alone, or a value alone, as in 'go to 1 {self.example}'")
        targets, self.clause.comparatives = self.clause.targets or self.vocabulary.of_kind("speed"), []
        self.clause.targets = []
        return Adjust(noun="speed" if len(targets) == 1 else "frequency", value=factor, how="times")

    def adjust(self, noun: str) -> Command:
        """Another amplitude or frequency of the last swing."""
        clause = self.clause
        sign = self.direction()
        quantity = self.take(lambda item: item.kind == noun or item.kind == "")
        share = clause.shares.pop() if clause.shares else None
        clause.nouns, clause.directions = [], []
        if (quantity is None) == (share is None):
            raise UserError(f"{noun} to what? say for example 'swing with an amplitude of 1 {self.example} at 0.5 Hz'")
        if share is not None:
            factor = share.factor if share.role != "by" else 1.0 + (sign or 1.0) * share.factor
            return Adjust(noun=noun, value=factor, how="times")
        assert quantity is not None
        relative = quantity.role == "by" or (sign != 0.0 and quantity.role == "")
        if quantity.base == PERCENT:
            factor = 0.01 * quantity.value
            return Adjust(noun=noun, value=1.0 + (sign or 1.0) * factor if relative else factor, how="times")
        if noun == "frequency" and quantity.base != FREQUENCY:
            raise UserError(f"{described(quantity)} is no frequency: give it in Hz")
        output = self.output(quantity)
        value = quantity.said if noun == "frequency" else self.value(quantity, output, relative=True)
        return Adjust(noun=noun, value=(sign or 1.0) * value if relative else value, how="by" if relative else "to")

    def move(self, shape: str) -> Move:
        """To one or several goals."""
        begin = self.one("from")
        for item in [each for each in self.left if each.role == "range"]:
            self.left.remove(item)
            if begin is None:
                begin = item
            else:
                self.left.append(replace(item, role="to"))
        seconds = self.seconds("in", "within")
        hold = self.seconds("for")
        rate = self.take(lambda item: item.role == "at" and self.is_rate(item))
        paces = [given for given in (self.pace, seconds and "a time", rate and "a rate") if given]
        if len(paces) > 1:
            raise UserError(f"{paces[0]} and {paces[1]} contradict one another: leave one out")
        shared = [item.unit for item in self.left if item.role == "to"]
        if begin is not None and begin.unit is None and shared:
            begin = replace(begin, unit=shared[0])
        if begin is not None and not shared:
            raise UserError(f"from {begin.value:g} to where? say 'from 0 to 1 {self.example}'")
        goals = self.goals()
        output = self.vocabulary.outputs[goals[0].output]
        return Move(
            goals=goals, shape=shape, begin=None if begin is None else self.value(begin, goals[0].output),
            pace=self.pace, seconds=seconds, rate=None if rate is None else abs(self.shown(rate, output, per=1)),
            hold=hold or 0.0,
        )  # fmt: skip

    def goals(self) -> tuple[Goal, ...]:
        """All values that are left."""
        sign, found = self.direction(), []
        after = {"by"} if sign or self.verb in ("go", "step", "ramp") else set()
        for item in [each for each in self.left if each.role in {"", "to", "at", *after}]:
            if item.base in (TIME, FREQUENCY, COUNT) or item.kind in ("amplitude", "frequency", "period"):
                continue
            self.left.remove(item)
            found.append(self.goal(item, sign))
        found += self.shares(sign)
        if not found and sign and self.clause.bit:
            output = self.only(self.clause.targets, self.clause.bit)
            shown = self.vocabulary.outputs[output]
            found = [Goal(output=output, value=sign * BIT * 0.5 * (shown.high - shown.low), relative=True)]
            self.clause.bit = ""
        self.clause.directions = []
        if not found:
            raise UserError(f"{self.verb} to where? say for example '{self.verb} to 1 {self.example}'")
        if self.clause.bit and found:
            raise UserError(f"{self.clause.bit!r} and a value contradict one another: leave one out")
        if len({goal.output for goal in found}) < len(found):
            raise UserError(f"{self.verb} has several values of one output: join them by 'then'")
        if unused := [k for k in self.clause.targets if k not in {goal.output for goal in found}]:
            raise UserError(f"{self.vocabulary.outputs[unused[0]].name} to what? say a value of it")
        return tuple(found)

    def goal(self, item: Quantity, sign: float) -> Goal:
        output = self.output(item)
        relative = item.role == "by" or (sign != 0.0 and item.role not in ("to", "at"))
        if relative and item.base == PERCENT:
            shown = self.vocabulary.outputs[output]
            change = 0.01 * abs(item.value)
            half = change * 0.5 * (shown.high - shown.low)
            factor = 1.0 + (sign or 1.0) * change
            raise UserError(
                f"{item.value:g} % of what it is now, or of the range? say 'to {100.0 * factor:g} % of its present "
                f"value', or 'by {half:.4g} {shown.unit}'"
            )
        if relative and sign and item.value < 0.0:
            raise UserError(f"{item.text}: a direction and a sign contradict one another: leave one out")
        value = (sign or 1.0 if relative else 1.0) * self.value(item, output, relative)
        return Goal(output=output, value=value, relative=relative, toward=sign)

    def shares(self, sign: float) -> list[Goal]:
        """Factors of the present value or of the range."""
        found = []
        for share in self.clause.shares:
            output = self.only(self.clause.targets, share.text)
            shown = self.vocabulary.outputs[output]
            factor = share.factor
            halving = not share.of and any(symbol.text == share.word for symbol in self.clause.verbs)
            if not halving and (share.role == "by" or (sign and share.role == "")):
                if not share.of and share.factor > 1.0:
                    raise UserError(f"{share.text!r} of what? say 'double it', or by how much")
                factor = 1.0 + (sign or 1.0) * factor
                if share.of == "range":
                    change = (sign or 1.0) * share.factor * 0.5 * (shown.high - shown.low)
                    found.append(Goal(output=output, value=change, relative=True))
                    continue
            elif share.of == "range":
                found.append(Goal(output=output, value=factor * shown.high, toward=sign))
                continue
            elif not share.of and not halving:
                raise UserError(
                    f"{share.text!r} of what it is now, or of the range? say 'halve it', or 'go to "
                    f"{factor * shown.high:.4g} {shown.unit}'"
                )
            if factor < 0.0 and output not in self.vocabulary.of_kind("speed"):
                raise UserError(f"{share.text!r}: {shown.name} is no speed: say 'go to' where")
            found.append(Goal(output=output, value=factor, share=True))
        self.clause.shares = []
        return found

    def only(self, targets: list[int], said: str) -> int:
        """The output that was named, or the only one. Raises UserError where that leaves several."""
        candidates = targets or [k for k in self.vocabulary.tracked if self.vocabulary.outputs[k].moves]
        if len(set(candidates)) != 1:
            raise UserError(f"{said!r} of which output? name one of {self.vocabulary.steered}")
        return candidates[0]

    def direction(self) -> float:
        """1, -1, or 0 where none was said. Raises UserError for two."""
        signs = {symbol.value for symbol in self.clause.directions}
        if len(signs) > 1:
            raise UserError("up and down contradict one another: leave one out")
        return signs.pop() if signs else 0.0
