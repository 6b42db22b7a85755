"""Drafts: a plan in the making, where it is, and the moves and waits that lead on, within the limits of the rig."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.commands import Goal, Home, Move, Undo, Wait
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import of_rig
from hybrid_sysid_ros.runtime.set_points import SetPointRange
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SHORTEST = 0.01
"""Seconds of a part that moves, at least."""
IN_MOVE = 40
"""Points of a smooth move."""
PEAK_SPEED, PEAK_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)
"""Of a smooth move by 1 in 1 s: the minimum-jerk motion 10 t^3 - 15 t^4 + 6 t^5 (Flash & Hogan 1985)."""
SHARES = {"slowly": 0.1, "": 0.4, "quickly": 0.8}
"""Of the speed and acceleration that the rig reaches, by the pace that a command names."""
JUMP = 1e-3
"""Seconds that a step of the reference takes."""


class Draft:
    """A plan that is being made."""

    def __init__(self, start: Array, vocabulary: Vocabulary, ability: Ability) -> None:
        self.vocabulary, self.ability = vocabulary, ability
        self.outputs = vocabulary.outputs
        self.here = np.array(start, dtype=float)
        self.times, self.values = [0.0], [self.here.copy()]
        self.jumps = False
        self.story: list[str] = []
        self.origins: list[Array] = []
        """Where each part began that moves."""

    def point(self, seconds: float) -> None:
        """Be at ``here`` so long after the last point."""
        self.times.append(self.times[-1] + seconds)
        self.values.append(self.here.copy())

    def wait(self, command: Wait) -> None:
        self.story.append(f"stay at {self.where()}" + (f" for {command.seconds:.4g} s" if command.seconds else ""))
        if command.seconds:
            self.point(command.seconds)

    def where(self) -> str:
        """Where the plan is."""
        moving = [k for k in self.vocabulary.tracked if self.outputs[k].moves]
        return ", ".join(f"{self.outputs[k].name} {self.level(k)}" for k in moving)

    def as_it_travels(self, values: Sequence[float], k: int) -> str:
        """Shown values of an output in the unit in which it travels, in brackets; empty if that measures the same."""
        output, (own, travels) = self.outputs[k], self.vocabulary.units_of(k)
        if own.alike(travels):
            return ""
        unit, scale = ("deg", math.degrees(output.scale)) if travels == of_rig("rad") else (travels.base, output.scale)
        said = " and ".join(f"{value * scale:.4g}" for value in values)
        return f" ({said} {unit})"

    def level(self, k: int) -> str:
        """Where an output is, in its units, and what that is in all, where the rig works about a point."""
        output = self.outputs[k]
        about = self.vocabulary.rig.system.operating_point.get(output.name)
        in_all = f" ({about / output.scale + self.here[k]:.6g} {output.unit} in all)" if about else ""
        return f"{with_unit(self.here[k], output)}{self.as_it_travels(self.here[[k]].tolist(), k)}{in_all}"

    def home(self, command: Home) -> None:
        goals = tuple(Goal(output=k, value=0.0) for k in self.vocabulary.tracked)
        self.move(Move(goals=goals, shape="smooth", pace=command.pace, seconds=command.seconds, hold=command.hold))

    def undo(self, command: Undo) -> None:
        """Back to where the parts before began. Raises UserError where that may be one of two places."""
        if (self.origins[0] != self.origins[-1]).any():
            k = int(np.flatnonzero(self.origins[0] != self.origins[-1])[0])
            first, last = (with_unit(origin[k], self.outputs[k]) for origin in (self.origins[0], self.origins[-1]))
            raise UserError(f"back to {first} or to {last} of {self.outputs[k].name}? say 'go to' one of them")
        if command.toward and (command.toward * (self.origins[0] - self.here) < 0.0).any():
            raise UserError("that is no way back: say 'repeat' for the same again, or 'up' or 'down' by how much")
        self.move(back_to(self.origins[0], self.vocabulary, command))

    def move(self, command: Move) -> None:
        first = command.goals[0]
        if command.begin is not None:
            before = Goal(output=first.output, value=command.begin)
            self.move(Move(goals=(before,), shape="step" if command.shape == "step" else "smooth"))
        ends = self.here.copy()
        for goal in command.goals:
            ends[goal.output] = self.end(goal)
            self.check_level(ends[goal.output], goal.output)
        change = ends - self.here
        starts, began = [self.level(goal.output) for goal in command.goals], self.times[-1]
        if not change.any():
            pass
        elif command.shape == "step":
            self.jumps = True
            self.here = ends
            self.point(JUMP)
        else:
            smooth = command.shape == "smooth"
            seconds = self.time_for(command, change, smooth)
            share = np.linspace(0.0, 1.0, IN_MOVE + 1)[1:] if smooth else np.ones(1)
            begin = self.here
            for part in share.tolist():
                along = part**3 * (10.0 - 15.0 * part + 6.0 * part**2) if smooth else part
                self.here = begin + along * change
                self.point(seconds / len(share))
            self.here = ends
        parts = [
            f"{self.outputs[goal.output].name} from {start} to {self.level(goal.output)}"
            for goal, start in zip(command.goals, starts, strict=True)
        ]
        how = {
            "smooth": f"in {self.times[-1] - began:.3g} s",
            "straight": f"straight in {self.times[-1] - began:.3g} s",
        }
        self.story.append(f"{' and '.join(parts)} {how.get(command.shape, 'at once')}")
        self.story[-1] += f", as {command.picture} shows" if command.picture else ""
        if command.hold:
            self.story[-1] += f", stay for {command.hold:.4g} s"
            self.point(command.hold)

    def end(self, goal: Goal) -> float:
        """Where a goal is. Raises UserError where that is not the way that was said, or a sign makes it two things."""
        here, output = float(self.here[goal.output]), self.outputs[goal.output]
        value = goal.value * here if goal.share else goal.value + (here if goal.relative else 0.0)
        of_speed = self.vocabulary.units_of(goal.output)[1].per > 0
        from_rest = of_speed and output.name not in self.vocabulary.rig.system.operating_point
        if goal.turned and here < 0.0:
            either = f"'go to {with_unit(value, output)}' or 'go to {with_unit(-value, output)}'"
            raise UserError(f"{output.name} is {with_unit(here, output)}: backwards, or around from that? say {either}")
        if goal.share and of_speed and not from_rest:
            raise UserError(
                f"{output.name} is counted from the rig's operating point: {with_unit(here, output)} is no speed to "
                f"take a share of: say by how much, as 'raise {output.name} by' and a number with its unit"
            )
        if from_rest and goal.relative and goal.toward < 0.0 and value < 0.0 <= here:
            less = with_unit(abs(goal.value), output)
            raise UserError(
                f"{output.name} is {with_unit(here, output)}, and less by {less} turns it around: say 'go to "
                f"{with_unit(value, output)}' if you mean it"
            )
        if goal.toward and from_rest and here < 0.0 and not goal.share:
            change, now = goal.toward * abs(goal.value), f"{output.name} is {with_unit(here, output)}"
            either = f"{with_unit(here + change, output)} or {with_unit(here - change, output)}"
            raise UserError(
                f"{now}: do you mean {either}? say 'go to' one of them"
                if goal.relative
                else f"{now}, which is below 0: say 'go to {with_unit(goal.value, output)}'"
            )
        if goal.toward and not goal.relative and not goal.share and goal.toward * (value - here) < 0.0:
            way = "below" if value < here else "above"
            raise UserError(
                f"{with_unit(value, output)} is {way} the {with_unit(here, output)} of {output.name} now: say 'go to "
                f"{with_unit(value, output)}' if you mean it"
            )
        return value

    def time_for(self, command: Move, change: Array, smooth: bool) -> float:
        """Seconds of a move, checked against what the rig reaches."""
        speed, acceleration = (PEAK_SPEED, PEAK_ACCELERATION) if smooth else (1.0, 0.0)
        moved = [k for k in np.flatnonzero(change).tolist() if self.outputs[k].moves]

        def usual(share: float) -> float:
            return max((self.least(k, change[k], speed, acceleration, share) for k in moved), default=0.0)

        if command.rate is not None:
            if command.rate <= 0.0:
                raise UserError("a rate of 0 goes nowhere: give one above 0")
            seconds = speed * abs(change[command.goals[0].output]) / command.rate
        elif command.seconds is not None:
            seconds = command.seconds
        else:
            seconds = usual(SHARES[command.pace])
        if command.pace == "slowly" and seconds < usual(SHARES[""]) * (1.0 - 1e-9):
            raise UserError(f"{command.pace} and in {seconds:.3g} s contradict one another: leave one out")
        for k in moved:
            least = self.least(k, change[k], speed, acceleration, 1.0)
            if seconds < least * (1.0 - 1e-9):
                asked, reached = abs(speed * change[k] / max(seconds, 1e-9)), self.ability.speed[k]
                output = self.outputs[k]
                raise UserError(
                    f"{output.name} by {with_unit(change[k], output)} in {seconds:.3g} s asks for {asked:.4g} "
                    f"{per_second(output)}; the rig reaches {reached:.4g}: take {up(least)} s or more"
                )
        return max(seconds, SHORTEST)

    def least(self, k: int, change: float, speed: float, acceleration: float, share: float) -> float:
        """Seconds of a change with that peak speed and acceleration by a unit in a second."""
        most = share * self.ability.speed[k], share * self.ability.acceleration[k]
        return max(speed * abs(change) / most[0], math.sqrt(acceleration * abs(change) / most[1]))

    def check_level(self, value: float, k: int) -> None:
        """Raise UserError for a value beyond the set-points."""
        output = self.outputs[k]
        slack = 1e-9 * (output.high - output.low)
        if not output.low - slack <= value <= output.high + slack:
            if not output.moves:
                raise UserError(f"{output.name} has no set-points in the rig's file: leave it out")
            about = self.vocabulary.rig.system.operating_point.get(output.name, 0.0) / output.scale
            counted = f", counted from {about:.6g} {output.unit}" if about else ""
            raise UserError(
                f"{output.name} of {with_unit(value, output)}{self.as_it_travels([value], k)} is out of reach: stay "
                f"within {output.low:.4g} and {output.high:.4g} {output.unit}"
                f"{self.as_it_travels([output.low, output.high], k)}{counted}; the nearest is "
                f"{with_unit(min(max(value, output.low), output.high), output)}"
            )


def back_to(origin: Array, vocabulary: Vocabulary, command: Undo) -> Move:
    """A move of the outputs that a command names, or of all, to places (outputs,), as they are shown."""
    moved = command.outputs or [k for k in vocabulary.tracked if vocabulary.outputs[k].moves]
    goals = tuple(Goal(output=k, value=float(origin[k])) for k in moved)
    return Move(goals=goals, shape="smooth", pace=command.pace, seconds=command.seconds)


def with_unit(value: float, output: SetPointRange) -> str:
    """A value with its unit."""
    return f"{value:.4g} {output.unit}".rstrip()


def per_second(output: SetPointRange) -> str:
    """The unit of an output's speed."""
    return f"{output.unit or '1'}/s"


def up(value: float) -> str:
    """Three digits, not below a value."""
    return f"{value * 1.005:.3g}"


def down(value: float) -> str:
    """Three digits, not above a value."""
    return f"{value * 0.995:.3g}"
