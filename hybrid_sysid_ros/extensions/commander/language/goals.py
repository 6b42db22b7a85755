"""Goals: where the values of a clause lead, as places, as changes, or as shares of what is."""

from __future__ import annotations

import re
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import Goal
from hybrid_sysid_ros.extensions.commander.language.stops import folded
from hybrid_sysid_ros.extensions.commander.language.values import Values
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, PERCENT, TIME
from hybrid_sysid_ros.support.errors import UserError

BIT = 0.05
"""Of half the set-points' range, by which "up a bit" changes them."""

OF = re.compile(r"(?:of|de)\s", re.IGNORECASE)
THROUGH = re.compile(r"through\s", re.IGNORECASE)
"""Before an amount, behind a verb of turning: "turn through 40 degrees"; to a value elsewhere."""
WAY = re.compile(r"^(?:by|em|por)\s+", re.IGNORECASE)
BEFORE = re.compile(r"^(?:(?:of|de|em|plus|mais)\s+|\+)+", re.IGNORECASE)
"""What may stand before a value, but not behind "to"."""


class Goals(Values):
    """Takes the values of one clause that a move goes to."""

    verb: str

    def goals(self) -> tuple[Goal, ...]:
        """All values that are left."""
        sign, found = self.direction(), list[Goal]()
        together = any(item.role == "to" for item in self.left)  # "up to 400 m and 15 m/s"
        after = {"by"} if sign or self.verb in ("go", "step", "ramp") else set()
        for item in [each for each in self.left if each.role in {"", "to", "at", *after}]:
            if item.base in (TIME, FREQUENCY, COUNT) or item.kind in ("amplitude", "frequency", "period"):
                continue
            self.left.remove(item)
            if self.verb == "step" and item.role == "" and OF.match(item.text):  # "a step of 1 m"
                item = replace(item, role="by")
            if sign and item.role == "" and found and not together:  # "raise height 100 m speed 10 m/s"
                raise UserError(f"{item.text!r}: to that value, or by it, too? say 'then' and 'to' or 'by' before it")
            item = replace(item, role=item.role or "to") if together else item
            found += [self.goal(one, sign) for one in self.each(item)]
        self.refuse_turning(found)
        found += self.shares(sign)
        if not found and sign and self.clause.bit:
            if [symbol.kind for symbol in self.clause.directions] == ["+"] and not self.clause.targets:
                raise UserError(f"{self.clause.bit!r} more of what? say 'up a bit' or 'down a bit'")
            output = self.only(self.clause.targets, self.clause.bit)
            shown = self.vocabulary.outputs[output]
            found = [Goal(output=output, value=sign * BIT * 0.5 * (shown.high - shown.low), relative=True)]
            self.clause.bit = ""
        if not found and self.clause.full_speed and (speeds := self.vocabulary.of_kind("speed")):
            output = self.only(self.clause.targets or speeds, self.clause.full_speed)
            found = [self.turned(Goal(output=output, value=self.vocabulary.outputs[output].high), sign)]
            self.clause.full_speed = ""
        said, self.clause.directions, self.clause.sense = self.clause.directions, [], None
        if not found and sign:
            way = "up" if sign > 0.0 else "down"
            raise UserError(f"{said[0].text!r} by how much? say '{way} a bit', or '{way} by 1 {self.example}'")
        if not found:
            raise IncompleteError(f"{self.verb} to where? say for example '{self.verb} to 1 {self.example}'")
        if len(found) > 1:
            self.clause.together = ""
        if self.clause.bit and not all(goal.relative for goal in found):
            raise UserError(f"{self.clause.bit!r} and a value contradict one another: leave one out")
        if len({goal.output for goal in found}) < len(found):
            raise IncompleteError(f"{self.verb} has several values of one output: join them by 'then'")
        if unused := [k for k in self.clause.targets if k not in {goal.output for goal in found}]:
            raise IncompleteError(f"{self.vocabulary.outputs[unused[0]].name} to what? say a value of it")
        self.clause.bit = ""  # "up a bit, by 1 m"
        return tuple(found)

    def at_a_rate(self, seconds: float) -> bool:
        """Whether a direction and how fast are all that is said; how far that leads then takes the rate's place."""
        outputs, item = self.clause.targets or list(self.vocabulary.tracked), next(iter(self.left), None)
        if not self.clause.directions or item is None or len(self.left) > 1 or item.unit is None:
            return False
        rates = [unit.rate for k in outputs for unit in self.vocabulary.units_of(k)]
        if item.role not in ("", "at", "by") or not any(map(item.unit.alike, rates)):
            return False
        way = item.unit._replace(per=item.unit.per - 1)
        self.left = [replace(item, value=item.value * seconds, unit=way, role="by")]
        return True

    def each(self, item: Quantity) -> list[Quantity]:
        """A value of each output that it is of: 0 may be of several, as in "both to 0"."""
        several = item.output is None and item.value == 0.0 and len(self.clause.targets) > 1
        return [replace(item, output=k) for k in dict.fromkeys(self.clause.targets)] if several else [item]

    def refuse_turning(self, found: list[Goal]) -> None:
        """Raise UserError for "reverse at 100 rpm"; a sign leaves no doubt."""
        turning = [share for share in self.clause.shares if share.factor < 0.0 and not share.of]
        led = any(
            item.role == "to" and folded(item.text)[:2] != "a " for item in self.clause.quantities
        )  # "reverse to"
        if turning and len(found) == 1 and not led and self.turns(found[0]):
            found[0] = replace(found[0], value=-found[0].value, turned=True)
        elif turning and found and found[0].value >= 0.0:
            shown = self.vocabulary.outputs[found[0].output]
            raise UserError(
                f"{turning[0].text!r} at {found[0].value:.4g} {shown.unit}: backwards, or around from what it is now? "
                f"say 'go to {-found[0].value:.4g} {shown.unit}' or 'go to {found[0].value:.4g} {shown.unit}'"
            )
        if found:
            self.clause.shares = [share for share in self.clause.shares if share not in turning]

    def turns(self, goal: Goal) -> bool:
        """Whether a goal is a speed, of which backwards means its other sense."""
        from_rest = self.vocabulary.outputs[goal.output].name not in self.vocabulary.rig.system.operating_point
        speed = goal.output in self.vocabulary.of_kind("speed")
        return speed and from_rest and goal.value > 0.0 and not goal.relative and not goal.toward

    def goal(self, item: Quantity, sign: float) -> Goal:
        output = self.output(item)
        self.refuse_rate(item, output)
        if sign and item.role == "at":
            raise UserError(f"{item.text!r}: to that value, or by it? say 'to' or 'by' instead of 'at'")
        verb = self.clause.displacing
        if verb and verb.value == "turn" and item.role == "to" and THROUGH.match(item.text):
            item = replace(item, role="by")
        if not sign and item.role == "" and self.adds(item, output):
            item = replace(item, role="by")
        if not sign and item.role == "" and self.open(item, output):
            said = f"{verb.text} {item.text}" if verb else item.text
            bare = BEFORE.sub("", item.text)
            raise UserError(f"{said!r}: to that value, or by it? say 'to {bare}' or 'by {bare}'")
        if not sign and item.role == "by" and self.unsigned(item):
            raise UserError(self.which_way(item, output))
        relative = item.role == "by" or (sign != 0.0 and item.role != "to")
        if relative and item.base == PERCENT:
            shown = self.vocabulary.outputs[output]
            change = 0.01 * (sign or 1.0) * item.value
            half = change * 0.5 * (shown.high - shown.low)
            factor = 1.0 + change
            raise UserError(
                f"{item.value:g} % of what it is now, or of the range? say 'to {100.0 * factor:g} % of its present "
                f"value', or 'by {half:.4g} {shown.unit}'"
            )
        if relative and sign and item.value < 0.0:
            raise UserError(f"{item.text}: a direction and a sign contradict one another: leave one out")
        value = (sign or 1.0 if relative else 1.0) * self.value(item, output, relative)
        if self.clause.from_home:
            self.clause.from_home = ""
            return Goal(output=output, value=value)  # "20 degrees to the left of straight ahead"
        return self.turned(Goal(output=output, value=value, relative=relative, toward=sign), sign)

    def turned(self, goal: Goal, sign: float) -> Goal:
        """A speed with the sense that was said. Raises UserError where that says nothing."""
        if (sense := self.clause.sense) is None:
            return goal
        output = self.vocabulary.outputs[goal.output]
        from_rest = output.name not in self.vocabulary.rig.system.operating_point
        if (
            sign
            or goal.relative
            or goal.value < 0.0
            or not from_rest
            or goal.output not in self.vocabulary.of_kind("speed")
        ):
            raise UserError(f"{sense.text!r}: directions are up and down, or a sign: say 'to' a value with its sign")
        return replace(goal, value=-goal.value) if sense.value == "backwards" else goal

    def adds(self, item: Quantity, output: int) -> bool:
        """Whether "plus" says a change, as in "height plus 80 m" of a rig that works about a point."""
        about = self.vocabulary.rig.system.operating_point.get(self.vocabulary.outputs[output].name)
        return bool(about) and folded(item.text.split()[0]) in ("plus", "mais")

    def unsigned(self, item: Quantity) -> bool:
        """Whether a change behind a verb that says no way, as "turn" or "change", says none either."""
        verb = self.clause.displacing
        signed = item.value <= 0.0 or BEFORE.match(WAY.sub("", item.text)) or self.clause.sense
        return verb is not None and verb.value in ("turn", "change") and not signed

    def which_way(self, item: Quantity, output: int) -> str:
        """The question after the way of a change, in the rig's own words of directions where it has some."""
        verb, shown = self.clause.displacing, self.vocabulary.outputs[output]
        bare = f"{self.value(item, output, True):.4g} {shown.unit}"
        said = f"{verb.text} {item.text}" if verb else item.text
        spoken = [words for words in self.vocabulary.spoken.values() for _ in "+-"]
        ways = [
            next((word for word, other in words.items() if other == sign + shown.name), "")
            for words, sign in zip(spoken, "+-" * 2, strict=True)
        ]
        own = f"{ways[0]!r} or {ways[1]!r}, or " if all(ways[:2]) else ""
        return f"{said!r}: which way? say {own}'by +{bare}' or 'by -{bare}'"

    def open(self, item: Quantity, output: int) -> bool:
        """Whether a bare value could be a place or a change: behind a verb of moving, or with a plus."""
        verb = self.clause.displacing
        if verb is not None and (verb.value == "change" or self.vocabulary.units_of(output)[0].per == 0):
            return True
        return item.text.startswith("+") or folded(item.text.split()[0]) in ("plus", "mais", "menos")

    def shares(self, sign: float) -> list[Goal]:
        """Factors of the present value or of the range."""
        found = []
        if self.clause.shares and self.clause.sense:
            raise UserError(f"{self.clause.sense.text!r}: directions are up and down, or a sign: say 'to' a value")
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
                if factor < 0.0 and output in self.vocabulary.of_kind("speed"):
                    lowest = f"{shown.low:.4g} {shown.unit}"
                    raise UserError(f"{share.text!r}: backwards, or at rest? say 'go to {lowest}' or 'go to 0'")
                value = factor * shown.high if factor >= 0.0 else -factor * shown.low
                found.append(Goal(output=output, value=value, toward=sign))
                continue
            elif not share.of and not halving and not (sign < 0.0 and share.role == "to" and factor < 1.0):
                if factor > 1.0:
                    raise UserError(f"{share.text!r}: say 'double it', or 'repeat' for what was done once more")
                raise UserError(
                    f"{share.text!r} of what it is now, or of the range? say 'halve it', or 'go to "
                    f"{factor * shown.high:.4g} {shown.unit}'"
                )
            if factor < 0.0 and output not in self.vocabulary.of_kind("speed"):
                raise UserError(f"{share.text!r}: {shown.name} is no speed: say 'go to' where")
            if sign and (factor < 0.0 or (share.role == "to" and (factor - 1.0) * sign < 0.0)):
                raise UserError(f"{share.text!r} and that direction contradict one another: leave one out")
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
            raise IncompleteError("up and down contradict one another: leave one out")
        return signs.pop() if signs else 0.0
