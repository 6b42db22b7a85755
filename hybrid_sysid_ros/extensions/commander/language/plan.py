"""Plans: what the outputs are to follow, as commands ask for it, within the limits of the rig."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.commands import Command, Follow, Goal, Home, Move, Swing, Wait
from hybrid_sysid_ros.extensions.commander.language.files import columns
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan, needed
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.runtime.configuration import SetPointRange
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

POINTS = 2000
"""Of a plan, at most: a message of them has some 100 KB."""
LONGEST = 120.0
"""Seconds of a plan, at most: all of it is simulated before."""
SHORTEST = 0.01
"""Seconds of a part that moves, at least."""
IN_MOVE, IN_PERIOD, LEAST_IN_PERIOD = 40, 48, 12
"""Points of a smooth move, and of a swing's period, at least where there are many."""
PEAK_SPEED, PEAK_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)
"""Of a smooth move by 1 in 1 s: the minimum-jerk motion 10 t^3 - 15 t^4 + 6 t^5 (Flash & Hogan 1985)."""
SHARES = {"slowly": 0.1, "": 0.4, "quickly": 0.8}
"""Of the speed and acceleration that the rig reaches, by the pace that a command names."""
JUMP = 1e-3
"""Seconds that a step of the reference takes."""
SPACING = 0.005
"""Seconds between two looks at one of the rig's own references."""
TOLERANCE = 1e-3
"""Of the set-points' range, within which a plan's straight lines are what they stand for."""


def plan_of(
    commands: Sequence[Command], start: Array, vocabulary: Vocabulary, ability: Ability, *, stops: bool = False
) -> ReferencePlan:
    """The plan of commands that begins at references ``start`` (outputs,), as they are shown.

    Raises UserError for values, speeds and accelerations that the rig can't reach, and for plans that are too long.
    """
    draft = _Draft(start, vocabulary, ability)
    for command in commands:
        draft.add(command)
    return draft.plan(stops=stops)


class _Draft:
    """A plan that is being made."""

    def __init__(self, start: Array, vocabulary: Vocabulary, ability: Ability) -> None:
        self.vocabulary, self.ability = vocabulary, ability
        self.outputs = vocabulary.outputs
        self.here = np.array(start, dtype=float)
        self.times, self.values = [0.0], [self.here.copy()]
        self.jumps = False
        self.story: list[str] = []

    def add(self, command: Command) -> None:
        """What a command asks for, from where the plan is."""
        makers: dict[type[Command], Callable[..., None]] = {
            Wait: self.wait, Home: self.home, Move: self.move, Swing: self.swing, Follow: self.follow,
        }  # fmt: skip
        makers[type(command)](command)
        if self.times[-1] > LONGEST:
            raise UserError(f"the plan takes {self.times[-1]:.4g} s: {LONGEST:g} s at most, say less or in parts")
        if len(self.times) > POINTS:
            raise UserError(f"the plan needs {len(self.times)} points: {POINTS} at most, say less or in parts")

    def plan(self, *, stops: bool) -> ReferencePlan:
        story = (*self.story, *(["inputs to rest"] if stops else []))
        return ReferencePlan(
            times=np.array(self.times), values=np.stack(self.values), jumps=self.jumps, stops=stops, story=story
        )

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

    def level(self, k: int) -> str:
        """Where an output is, and what that is in all, where the rig works about a point."""
        output = self.outputs[k]
        about = self.vocabulary.rig.system.operating_point.get(output.name)
        in_all = f" ({about / output.scale + self.here[k]:.6g} {output.unit} in all)" if about else ""
        return f"{_shown(self.here[k], output)}{in_all}"

    def home(self, command: Home) -> None:
        goals = tuple(Goal(output=k, value=0.0) for k in self.vocabulary.tracked)
        self.move(Move(goals=goals, shape="smooth", pace=command.pace))

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
        if from_rest and goal.relative and goal.toward < 0.0 and value < 0.0 <= here:
            less = _shown(abs(goal.value), output)
            raise UserError(
                f"{output.name} is {_shown(here, output)}, and less by {less} turns it around: say 'go to "
                f"{_shown(value, output)}' if you mean it"
            )
        if goal.toward and from_rest and here < 0.0 and not goal.share:
            change, now = goal.toward * abs(goal.value), f"{output.name} is {_shown(here, output)}"
            either = f"{_shown(here + change, output)} or {_shown(here - change, output)}"
            raise UserError(
                f"{now}: do you mean {either}? say 'go to' one of them"
                if goal.relative
                else f"{now}, which is below 0: say 'go to {_shown(goal.value, output)}'"
            )
        if goal.toward and not goal.relative and not goal.share and goal.toward * (value - here) < 0.0:
            way = "below" if value < here else "above"
            raise UserError(
                f"{_shown(value, output)} is {way} the {_shown(here, output)} of {output.name} now: say 'go to "
                f"{_shown(value, output)}' if you mean it"
            )
        return value

    def time_for(self, command: Move, change: Array, smooth: bool) -> float:
        """Seconds of a move, checked against what the rig reaches."""
        speed, acceleration = (PEAK_SPEED, PEAK_ACCELERATION) if smooth else (1.0, 0.0)
        moved = [k for k in np.flatnonzero(change) if self.outputs[k].moves]
        if command.rate is not None:
            if command.rate <= 0.0:
                raise UserError("a rate of 0 goes nowhere: give one above 0")
            seconds = speed * abs(change[command.goals[0].output]) / command.rate
        elif command.seconds is not None:
            seconds = command.seconds
        else:
            share = SHARES[command.pace]
            seconds = max((self.least(k, change[k], speed, acceleration, share) for k in moved), default=0.0)
        for k in moved:
            least = self.least(k, change[k], speed, acceleration, 1.0)
            if seconds < least * (1.0 - 1e-9):
                asked, reached = abs(speed * change[k] / max(seconds, 1e-9)), self.ability.speed[k]
                output = self.outputs[k]
                raise UserError(
                    f"{output.name} by {_shown(change[k], output)} in {seconds:.3g} s asks for {asked:.4g} "
                    f"{_per_second(output)}; the rig reaches {reached:.4g}: take {_up(least)} s or more"
                )
        return max(seconds, SHORTEST)

    def least(self, k: int, change: float, speed: float, acceleration: float, share: float) -> float:
        """Seconds of a change with that peak speed and acceleration by a unit in a second."""
        most = share * self.ability.speed[k], share * self.ability.acceleration[k]
        return max(speed * abs(change) / most[0], math.sqrt(acceleration * abs(change) / most[1]))

    def swing(self, command: Swing) -> None:
        k = command.output
        about = self.here[k] if command.relative else 0.0
        first, last = command.low + about, command.high + about
        for value in (first, last):
            self.check_level(value, k)
        span, highest = abs(last - first), max(command.frequency, command.last_frequency or 0.0)
        if span == 0.0:
            raise UserError(f"both ends are {_shown(first, self.outputs[k])}: that is no swing; say hold")
        if command.seconds > LONGEST:
            raise UserError(f"the plan takes {command.seconds:.4g} s: {LONGEST:g} s at most, say less or in parts")
        periods = command.seconds * highest
        if periods * (4 if command.shape == "square" else LEAST_IN_PERIOD) > POINTS - len(self.times):
            raise UserError(f"{periods:.4g} periods need too many points: say less or in parts")
        self.tell_swing(command, first, last)
        if command.shape == "square":
            self.square(k, first, last, command)
            return
        self.check_swing(k, span, highest, command.shape)
        count = len(self.story)
        self.move(Move(goals=(Goal(output=k, value=first),), shape="smooth"))
        del self.story[count:]
        if command.shape == "triangle":
            self.triangle(k, first, last, command)
            return
        dense = int(np.clip((POINTS - len(self.times)) / max(periods, 1e-9), LEAST_IN_PERIOD, IN_PERIOD))
        count = max(2, math.ceil(periods * dense))
        sweep = ((command.last_frequency or command.frequency) - command.frequency) / command.seconds
        for t in np.linspace(0.0, command.seconds, count + 1)[1:].tolist():
            phase = 2.0 * math.pi * (command.frequency + 0.5 * sweep * t) * t
            self.here[k] = 0.5 * (first + last) + 0.5 * (first - last) * math.cos(phase)
            self.point(command.seconds / count)

    def tell_swing(self, command: Swing, first: float, last: float) -> None:
        output = self.outputs[command.output]
        name = {"sine": "swing", "square": "square wave", "triangle": "triangle wave"}[command.shape]
        hertz = f"{command.frequency:.4g} Hz"
        hertz = f"{command.frequency:.4g} to {command.last_frequency:.4g} Hz" if command.last_frequency else hertz
        self.story.append(
            f"{name} of {output.name} from {self.level(command.output)} between {_shown(first, output)} and "
            f"{_shown(last, output)} at {hertz} for {command.seconds:.4g} s"
        )

    def check_swing(self, k: int, span: float, frequency: float, shape: str) -> None:
        """Raise UserError for a swing that asks for more speed or acceleration than the rig reaches."""
        speed, acceleration = math.pi * frequency * span, 2.0 * (math.pi * frequency) ** 2 * span
        highest = min(
            self.ability.speed[k] / (math.pi * span), math.sqrt(self.ability.acceleration[k] / (2.0 * span)) / math.pi
        )
        if shape == "triangle":
            speed, highest = 2.0 * frequency * span, self.ability.speed[k] / (2.0 * span)
        if frequency > highest:
            output = self.outputs[k]
            raise UserError(
                f"{output.name} over {_shown(span, output)} at {frequency:.4g} Hz asks for {speed:.4g} "
                f"{_per_second(output)} and {acceleration:.4g} {_per_second(output)}^2: the rig reaches it up to "
                f"{_down(highest)} Hz, or take a smaller span"
            )

    def triangle(self, k: int, first: float, last: float, command: Swing) -> None:
        """Straight lines between two levels."""
        half, left, values = 0.5 / command.frequency, command.seconds, (last, first)
        for count in range(math.ceil(command.seconds / half - 1e-9)):
            share = min(1.0, left / half)
            self.here[k] += share * (values[count % 2] - self.here[k])
            self.point(share * half)
            left -= half

    def square(self, k: int, first: float, last: float, command: Swing) -> None:
        """Steps between two levels."""
        self.jumps = True
        half, left, values = 0.5 / command.frequency, command.seconds, (first, last)
        if half <= 2.0 * JUMP:
            raise UserError(f"steps every {half:.3g} s are none: take {20 * JUMP:g} s or more")
        for count in range(math.ceil(command.seconds / half - 1e-9)):
            self.here[k] = values[count % 2]
            self.point(JUMP)
            self.point(min(half, left) - JUMP if left > JUMP else JUMP)
            left -= half

    def follow(self, command: Follow) -> None:
        if command.path is None:
            schedule = self.vocabulary.rig.references[command.name]
            times: Array = np.arange(
                0.0, min(schedule.duration, 2.0 * LONGEST) + SPACING / 2.0, SPACING, dtype=np.float64
            )
            table = schedule(times)
            table[-1] = table[-2]  # its last value is the one that is held
            self.jumps = True
            given = {k: table[:, k] for k in self.vocabulary.tracked if table[:, k].any()}
        else:
            times, given = columns(command.path, self.vocabulary)
        for k, values in given.items():
            self.check_level(float(values.min()), k)
            self.check_level(float(values.max()), k)
            if command.path is not None:
                self.check_speed(times, values, k, command.name)
        first = tuple(Goal(output=k, value=float(values[0])) for k, values in given.items())
        if first:
            self.move(Move(goals=first, shape="smooth"))
        rows = np.tile(self.here, (len(times), 1))
        for k, values in given.items():
            rows[:, k] = values
        kept = needed(times, rows, [TOLERANCE * (output.high - output.low) for output in self.outputs])
        begin = self.times[-1]
        self.story.append(f"follow {command.name} for {times[-1]:.4g} s")
        self.times += (begin + times[kept[1:]]).tolist()
        self.values += list(rows[kept[1:]])
        self.here = rows[-1].copy()

    def check_level(self, value: float, k: int) -> None:
        """Raise UserError for a value beyond the set-points."""
        output = self.outputs[k]
        slack = 1e-9 * (output.high - output.low)
        if not output.low - slack <= value <= output.high + slack:
            about = self.vocabulary.rig.system.operating_point.get(output.name, 0.0) / output.scale
            counted = f", counted from {about:.6g} {output.unit}" if about else ""
            if about and output.low <= value - about <= output.high:
                counted += f"; {value:.6g} {output.unit} in all are {_shown(value - about, output)} here"
            raise UserError(
                f"{output.name} of {_shown(value, output)} is out of reach: stay within {output.low:.4g} and "
                f"{output.high:.4g} {output.unit}{counted}"
            )

    def check_speed(self, times: Array, values: Array, k: int, name: str) -> None:
        """Raise UserError for a file that goes faster than the rig."""
        speeds = np.abs(np.diff(values) / np.diff(times))
        worst, output = int(np.argmax(speeds)), self.outputs[k]
        if speeds[worst] > self.ability.speed[k]:
            raise UserError(
                f"{name}: at {times[worst]:.4g} s {output.name} goes at {speeds[worst]:.4g} {_per_second(output)}; the "
                f"rig reaches {self.ability.speed[k]:.4g}: stretch its times"
            )


def _shown(value: float, output: SetPointRange) -> str:
    return f"{value:.4g} {output.unit}".rstrip()


def _per_second(output: SetPointRange) -> str:
    return f"{output.unit or '1'}/s"


def _up(value: float) -> str:
    """Three digits, not below the value."""
    return f"{value * 1.005:.3g}"


def _down(value: float) -> str:
    return f"{value * 0.995:.3g}"
