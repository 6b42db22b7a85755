"""Verbs: which of the verbs of one clause says what is asked for, or which one it means where it has none."""

from __future__ import annotations

import re
from itertools import pairwise

from hybrid_sysid_ros.extensions.commander.language.adjustments import Adjustments
from hybrid_sysid_ros.extensions.commander.language.clauses import IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.files import is_picture
from hybrid_sysid_ros.rigs.units import COUNT, FREQUENCY, TIME
from hybrid_sysid_ros.support.errors import UserError

AGAIN = re.compile(r"(?:once )?again|de novo|novamente|outra vez")
"""Of one who says once more what he says, too."""
AGAIN_TO = re.compile(r"(?:take|put|bring|get) .*back|restore|back")
"""Verbs of going back that take a place as well."""
LIGHT = {"hold", "go", "follow"}
"""Verbs that say nothing of their own right before another one that moves."""
STAYING = {"hold", "still", "wait", "halt"}
FLAT = {"go", "step", "ramp", "stairs"}
"""Verbs that may lead along stairs."""
SPECIFIC = {"swing", "square", "toggle", "triangle", "chirp", "home", "undo"}
"""Verbs that say all, beside a general one."""


class Verbs(Adjustments):
    """Chooses the verb of one clause."""

    behind: bool

    def chosen(self) -> str:
        """The verb. Raises UserError for none, and for two that are not one motion."""
        clause = self.clause
        found = list(dict.fromkeys(symbol.value for symbol in clause.verbs))
        going = [symbol for symbol in clause.verbs if symbol.value == "go"]
        if len(going) > 1 and not all(clause.adjacent(*pair) for pair in pairwise(going)):
            raise IncompleteError(f"{going[0].text} and {going[1].text} in one part: join them by 'then'")
        if "back" in found and not clause.directions and "by" in self.roles:
            raise UserError(f"back by how much is up or down? say 'up 1 {self.example}' or 'down 1 {self.example}'")
        if "follow" in found and not clause.names and len(found) > 1 and "step" not in found:
            found.remove("follow")  # "run the last experiment", "fly a staircase"
        if "repeat" in found and len(found) > 1 and (self.left or {"undo", "home"} & {*found}):
            # "undo the last command", "level again"
            found.remove("repeat")
        changed = clause.nouns or clause.comparatives or any(item.kind or item.base == FREQUENCY for item in self.left)
        if len(found) == 2 and found[0] in LIGHT and found[1] not in STAYING and self._side_by_side():
            found = found[1:]  # "it should be doing 1 m", "let it keep swinging"
        if self._climbs(found):
            return "stairs"
        led = any(item.role == "to" for item in self.left)
        if "undo" in found and led and AGAIN_TO.match(next(each.text for each in clause.verbs if each.value == "undo")):
            found[found.index("undo")] = "go"  # "take it back to 3 m"
        if found == ["home"] and led and clause.verbs[0].text.startswith("reset"):
            found = ["go"]  # "reset the height to 10 m"
        if found == ["repeat"] and AGAIN.match(clause.verbs[0].text) and any(map(self._is_place, self.left)):
            found = ["go"]  # "forward again at 1 m/s"
        turned = any(way.text in self.vocabulary.sides for way in clause.directions)
        if found == ["swing"] and turned and len(self.left) == 1 and self._is_place(self.left[0]):
            found = ["go"]  # "swing it 15 degrees to the left"
        if found == ["step", "back"]:
            found = ["back"]  # "step it back"
        being = {
            symbol.value for symbol in clause.verbs if symbol.text.split()[-1] == "be"
        }  # "let it be a square wave"
        general = {"go", *being, "step", "ramp", "back", *([] if clause.names else ["follow"])}  # "run a chirp"
        if "hold" in found and {"home", "undo"} & {*found} and not self.left:  # "stay at the equilibrium"
            found.remove("hold")
        if found == ["chirp"] and not any(item.base == FREQUENCY for item in self.left) and self.span_in_time():
            found = ["ramp"]  # "sweep from 1 to 2 m in 5 s"
        if set(found) & SPECIFIC:
            found = [verb for verb in found if verb not in general]
        if "swing" in found and {"chirp", "square", "triangle", "toggle"} & {*found}:
            found.remove("swing")  # "sweep sinusoidally", "back and forth, square wave"
        if found in (["go", "step"], ["step", "go"], ["go", "ramp"], ["ramp", "go"]):
            found.remove("go")
        changes = clause.comparatives or (clause.nouns and clause.shares)
        slower = found == ["swing"] and changes and not self.left  # "swing slower", "swing with twice the amplitude"
        if slower or (found == ["repeat"] and changed):  # "the same but slower", "again at 1 Hz"
            found = ["go"]
        if found in (["go", "back"], ["back", "go"], ["back"]):
            found = ["undo" if self._returns() else "go"]
        if found == ["repeat"] and clause.names:
            found = ["follow"]  # "repeat moves twice"
        if found == ["follow"] and not clause.names and not self._alone():
            found, clause.displacing = ["go"], clause.verbs[-1]  # "run at 100 rpm", "fly 100 m"
        if not found and clause.names:
            found = ["look" if is_picture(clause.names[0]) else "follow"]
        if {*found} == {"follow", "step"} and not clause.names:
            return "follow"  # "follow steps", where there is no such reference
        if (
            found in ([], ["go"])
            and any(item.base == FREQUENCY or item.kind == "period" or item.role == "every" for item in self.left)
            and any(item.role in ("plus_minus", "between") for item in self.left)
        ):
            found = ["swing"]
        if not found and clause.wish and self.left and all(item.base == TIME for item in self.left):
            found = ["wait"]  # "give it 5 s"
        if not found and (
            clause.directions or clause.comparatives or clause.targets or clause.shares or clause.full_speed
            or self.span_in_time() or (clause.sense and self.left)
            or any(item.role in ("to", "range") or self.adjusted(item) for item in self.left) or self._said()
        ):  # fmt: skip
            found = ["go"]
        if len(found) > 1:
            raise IncompleteError(f"{found[0]} and {found[1]} in one part: join them by 'then'")
        if not found and self.left and all(item.base == FREQUENCY for item in self.left):
            found = ["go"]  # "now at 0.3 Hz", of the last swing
        if not found and self.left and all(item.base == COUNT for item in self.left):
            found = ["repeat"]  # "three more times"
        if not found and clause.here:
            found = ["hold"]
        if not found:
            raise IncompleteError(
                "no verb: begin with 'go to', 'hold', 'ramp to', 'step to', 'swing', 'wait', 'home' or 'stop'"
            )
        return found[0]

    def _is_place(self, item: Quantity) -> bool:
        return item.role in ("", "at", "to") and item.unit is not None and item.base not in (TIME, FREQUENCY, COUNT)

    def _side_by_side(self) -> bool:
        """Whether two verbs are the only ones, and the later one stands right behind the first."""
        first, second = self.clause.verbs[0], self.clause.verbs[-1]
        return len(self.clause.verbs) == 2 and self.clause.adjacent(first, second)

    def span_in_time(self) -> bool:
        """Whether a clause leads from one value to another one in a time."""
        return {"range", "in"} <= self.roles or {"span", "in"} <= self.roles

    def _climbs(self, found: list[str]) -> bool:
        """Whether a clause asks for stairs: by the word, by what each step is, or by "up 1 m every 5 s"."""
        clause, roles = self.clause, self.roles
        said = clause.increment or clause.count_of_steps or "stairs" in found
        rises = clause.directions or "by" in roles or ("step" in found and roles & {"range", "to"})
        return set(found) <= FLAT and bool(said or ("every" in roles and rises))

    def _returns(self) -> bool:
        """Whether "back" says nothing of where, but for "down again", which is where it was."""
        clause = self.clause
        counted = [
            item for item in self.left if item.base == COUNT or (item.base == TIME and item.role in ("in", "within"))
        ]
        twice = [share for share in clause.shares if not share.role and not share.of and share.factor in (2.0, 3.0)]
        if not self.behind and clause.directions:
            return False
        kept = self.left, clause.shares, clause.directions
        self.left = [item for item in self.left if item not in counted]
        clause.shares = [share for share in clause.shares if share not in twice]
        clause.directions = []
        alone = self._alone()
        self.left, clause.shares, clause.directions = kept
        return alone

    def _alone(self) -> bool:
        """Whether nothing is said beside the verb."""
        clause = self.clause
        return not (
            self.left or clause.directions or clause.comparatives or clause.targets or clause.shares or clause.names
            or clause.nouns or clause.here or clause.full_speed
        )  # fmt: skip

    def _said(self) -> bool:
        """Whether a value is asked for without a verb: by "I want", or by how long it is to last."""
        return ("" in self.roles and "for" in self.roles) or bool(self.clause.wish and {"", "at"} & self.roles)
