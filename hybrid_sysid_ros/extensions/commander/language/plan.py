"""Plans: what the outputs are to follow, as commands ask for it, within the limits of the rig."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Follow,
    Goal,
    Home,
    Move,
    Staircase,
    Swing,
    Undo,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.draft import JUMP, SHARES, Draft, down, per_second, with_unit
from hybrid_sysid_ros.extensions.commander.language.files import columns
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan, needed
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

POINTS = 2000
"""Of a plan, at most: a message of them has some 100 KB."""
LONGEST = 600.0
"""Seconds of a plan, at most: all of it is simulated before."""
IN_PERIOD, LEAST_IN_PERIOD = 48, 12
"""Points of a swing's period, at least where there are many."""
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
    draft = _Plan(start, vocabulary, ability)
    for command in commands:
        draft.add(command)
    return draft.plan(stops=stops)


class _Plan(Draft):
    """Adds what each command asks for."""

    def add(self, command: Command) -> None:
        """What a command asks for, from where the plan is."""
        makers: dict[type[Command], Callable[..., None]] = {
            Wait: self.wait, Home: self.home, Move: self.move, Swing: self.swing, Follow: self.follow, Undo: self.undo,
            Staircase: self.staircase,
        }  # fmt: skip
        if not isinstance(command, Wait | Undo):
            self.origins.append(self.here.copy())
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

    def staircase(self, command: Staircase) -> None:
        """Steps from level to level. Raises UserError where these lead elsewhere than was said, or nowhere."""
        k, rise, count, parts = command.output, command.rise or 0.0, command.count, len(self.story)
        output = self.outputs[k]
        if command.begin is not None:
            self.move(Move(goals=(Goal(output=k, value=command.begin),), shape="smooth", hold=command.seconds))
        first = float(self.here[k])
        sign = command.toward or 1.0
        last = first + sign * rise * count if command.end is None else command.end
        last = first + sign * abs(command.end or 0.0) if command.relative else last
        way = math.copysign(1.0, last - first)
        if last == first or (way * sign < 0.0 and command.toward):
            raise UserError(
                f"stairs from {with_unit(first, output)} to {with_unit(last, output)} lead "
                f"{'nowhere' if last == first else 'the other way'}: say 'from' where to where"
            )
        if rise > abs(last - first) * (1.0 + 1e-9):
            raise UserError(
                f"steps of {with_unit(rise, output)} do not fit between {with_unit(first, output)} and "
                f"{with_unit(last, output)}: say smaller ones, or 'step to' it"
            )
        count = count or math.ceil(abs(last - first) / rise - 1e-9)
        levels = [first + way * (rise or abs(last - first) / count) * (step + 1) for step in range(count - 1)] + [last]
        for level in levels:
            self.move(Move(goals=(Goal(output=k, value=level),), shape="step", hold=command.seconds))
        shown = ", ".join(f"{level:.4g}" for level in ([first, *levels] if command.begin is not None else levels))
        del self.story[parts:]
        self.story.append(f"{output.name} in {count} steps to {shown} {output.unit}, {command.seconds:.4g} s at each")

    def swing(self, command: Swing) -> None:
        k = command.output
        about = self.here[k] if command.relative else 0.0
        first, last = command.low + about, command.high + about
        for value in (first, last):
            self.check_level(value, k)
        span, highest = abs(last - first), max(command.frequency, command.last_frequency or 0.0)
        if span == 0.0:
            raise UserError(f"both ends are {with_unit(first, self.outputs[k])}: that is no swing; say hold")
        if command.seconds > LONGEST:
            raise UserError(f"the plan takes {command.seconds:.4g} s: {LONGEST:g} s at most, say less or in parts")
        periods = command.seconds * highest
        if periods * (4 if command.shape == "square" else LEAST_IN_PERIOD) > POINTS - len(self.times):
            raise UserError(f"{periods:.4g} periods need too many points: say less or in parts")
        self.tell_swing(command, first, last)
        if command.shape == "square":
            self.square(k, first, last, command)
            return
        self.check_swing(k, span, highest, command.shape, command.pace)
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
            f"{name} of {output.name} from {self.level(command.output)} between {with_unit(first, output)} and "
            f"{with_unit(last, output)} at {hertz} for {command.seconds:.4g} s"
        )

    def check_swing(self, k: int, span: float, frequency: float, shape: str, pace: str) -> None:
        """Raise UserError for a swing that asks for more speed or acceleration than the rig reaches."""
        speed, acceleration = math.pi * frequency * span, 2.0 * (math.pi * frequency) ** 2 * span
        if pace and speed > SHARES[""] * self.ability.speed[k]:
            raise UserError(f"{pace} and at {frequency:.4g} Hz contradict one another: leave one out")
        highest = min(
            self.ability.speed[k] / (math.pi * span), math.sqrt(self.ability.acceleration[k] / (2.0 * span)) / math.pi
        )
        if shape == "triangle":
            speed, highest = 2.0 * frequency * span, self.ability.speed[k] / (2.0 * span)
        if frequency > highest:
            output = self.outputs[k]
            raise UserError(
                f"{output.name} over {with_unit(span, output)} at {frequency:.4g} Hz asks for {speed:.4g} "
                f"{per_second(output)} and {acceleration:.4g} {per_second(output)}^2: the rig reaches it up to "
                f"{down(highest)} Hz, or take a smaller span"
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

    def check_speed(self, times: Array, values: Array, k: int, name: str) -> None:
        """Raise UserError for a file that goes faster than the rig."""
        speeds = np.abs(np.diff(values) / np.diff(times))
        worst, output = int(np.argmax(speeds)), self.outputs[k]
        if speeds[worst] > self.ability.speed[k]:
            raise UserError(
                f"{name}: at {times[worst]:.4g} s {output.name} goes at {speeds[worst]:.4g} {per_second(output)}; the "
                f"rig reaches {self.ability.speed[k]:.4g}: stretch its times"
            )
