"""Joining: how the commands of a sentence's parts go together, and what a part takes from those before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hybrid_sysid_ros.extensions.commander.language.clauses import Clause, IncompleteError, Quantity
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Follow,
    Home,
    Move,
    Repeat,
    Sentence,
    Swing,
    Undo,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.extensions.commander.language.values import Values
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import TIME
from hybrid_sysid_ros.support.errors import UserError

CARRIED = ("go", "hold", "ramp", "step", "follow")
"""Verbs that count for the next part, too, where it has a value and no verb."""


KEPT_AND_CHANGED = "keep the same output, and change it? say 'then' between the two, or leave one out"


def all_again(sentence: Sentence, rounds: int) -> Sentence:
    """So many rounds of a sentence. Raises UserError for one that waits or stops."""
    if sentence.later is not None or sentence.stops:
        raise UserError(f"{rounds} times what waits or stops? say the parts without it")
    return replace(sentence, commands=sentence.commands * rounds)


def joined(before: list[Command], made: Command, said: str) -> list[Command]:
    """Commands of which the last one and another move at the same time. Raises UserError for what can't."""
    if not before:
        raise UserError(f"{said!r} what? say both values in one part, as in 'height 100 m and speed 10 m/s in 60 s'")
    last = before[-1]
    plain = [isinstance(each, Move) and each == Move(goals=each.goals, shape="smooth") for each in (last, made)]
    if not (isinstance(last, Move) and isinstance(made, Move) and all(plain)):
        raise UserError(f"{said!r}: say both values in one part, as in 'height 100 m and speed 10 m/s in 60 s'")
    goals = (*last.goals, *made.goals)
    if len({goal.output for goal in goals}) < len(goals):
        raise UserError(f"{said!r}: one output has one value at a time: join the parts by 'then'")
    return [*before[:-1], replace(last, goals=goals)]


def repeated(before: list[Command], made: Command, times: int, *, joined: bool) -> list[Command]:
    """Commands and another one so many times, or all of them where that one alone would come to nothing new; "and back"
    goes with the part before. Raises UserError where it is unclear what is done again.
    """
    alone = isinstance(made, Follow) or (isinstance(made, Move) and all(goal.relative for goal in made.goals))
    if times == 1 or (alone and (not before or isinstance(made, Follow))):
        return [*before, *[made] * times]
    if alone or not before:
        raise IncompleteError(f"{times} times of what? say all parts, and then 'repeat {times} times'")
    if isinstance(made, Undo):
        if made.seconds is not None and isinstance(before[-1], Move) and before[-1].seconds is None and joined:
            raise UserError(
                f"in {made.seconds:g} s there and back, or back alone? say how long the way there takes, too"
            )
        return [*before[:-1], *[before[-1], made] * times]
    return [*before, made] * times


def carried(commands: Sequence[Command], before: Sequence[Clause], *, then: bool) -> list[Symbol]:
    """The verbs of a part that count for the next one, too, as in "hold 1 m, then 2 m". After "up 1 m" the next value
    could be a change or a place, so there is none; behind a swing and a "then" it is a place.
    """
    done = [command for command in commands if not isinstance(command, Wait)]
    last = done[-1] if done else None
    if then and isinstance(last, Swing):
        return [Symbol("V", "go", "go")]
    if last and not (isinstance(last, Move) and not any(goal.relative or goal.share for goal in last.goals)):
        return []
    carried = [symbol for symbol in before[-1].verbs if symbol.value in CARRIED] if before else []
    return carried or [Symbol("V", "go", "go")]


def held_each(commands: Sequence[Command], each: Quantity, seconds: float) -> list[Command]:
    """Moves with as long a hold each. Raises UserError where there are not several, or one has its own."""
    moves = [command for command in commands if isinstance(command, Move | Home) and not command.hold]
    if len(moves) < max(2, len(commands)) or each.base != TIME:
        raise IncompleteError(f"{each.text!r} of what? say 'for 2 s' behind each value")
    return [replace(move, hold=seconds) for move in moves]


def acts(commands: Sequence[Command]) -> bool:
    """Whether commands lead somewhere, which "there" and "again" may mean."""
    return any(not isinstance(command, Repeat) for command in commands)


def arrival(clause: Clause) -> Command:
    """What "and stop there" asks for: to stay."""
    if clause.quantities or clause.targets or clause.directions:
        raise UserError("'stop' works at once: say 'go to' or 'hold' where the rig is to stay")
    return Wait(seconds=0.0)


def at_odds(commands: Sequence[Command], made: Command, *, stays: bool, listed: bool, still: set[int]) -> str:
    """What is doubtful of a move that no "then" parts from the one before; stays: it is a hold where it is; listed: it
    is one more value of those before; still: the outputs that the one before was said to keep.
    """
    last = commands[-1] if commands else None
    if isinstance(made, Move) and still.intersection(goal.output for goal in made.goals):
        return KEPT_AND_CHANGED
    if not (isinstance(last, Move) and isinstance(made, Move)) or last.hold:
        return ""
    there = {goal.output: goal.value for goal in last.goals if not goal.relative}
    if all(goal.share and goal.value == -1.0 for goal in made.goals):
        return "around once it is there, or that way from the start? say 'then reverse', or a value with its sign"
    if stays and any(there.get(goal.output, goal.value) != goal.value for goal in made.goals):
        return "go there, and stay elsewhere? say 'then', or leave one out"
    if listed and {goal.output for goal in last.goals} & {goal.output for goal in made.goals}:
        return "several values of one output: join them by 'then', or say how long each lasts"
    return ""


def has_moved(commands: Sequence[Command], outputs: set[int]) -> bool:
    """Whether the last command moves one of some outputs, or any where none was named."""
    goals = {goal.output for goal in commands[-1].goals} if commands and isinstance(commands[-1], Move) else set[int]()
    return bool(goals & outputs if outputs else goals)


def has_stayed(commands: Sequence[Command], vocabulary: Vocabulary) -> bool:
    """Whether the last command led to a speed for some time: "then stay" leaves open whether it goes on."""
    last = commands[-1] if commands else None
    speeds = vocabulary.of_kind("rest")
    return (
        isinstance(last, Move) and last.hold > 0.0 and all(goal.output in speeds and goal.value for goal in last.goals)
    )


def brought_to_rest(clause: Clause, vocabulary: Vocabulary) -> Command:
    """What a stop that takes its time asks for: all outputs to 0, where these are speeds that have a rest."""
    moving = {k for k in vocabulary.tracked if vocabulary.outputs[k].moves}
    if moving != {*vocabulary.of_kind("rest")} or not stands_alone(clause):
        raise UserError("'stop' works at once: say where to go, and how fast")
    return Home(pace=clause.paces[0], seconds=None if clause.delay is None else Values(clause, vocabulary).delay())


def stands_alone(clause: Clause) -> bool:
    """Whether a clause says nothing beside a condition or a delay."""
    return not (
        clause.quantities or clause.shares or clause.targets or clause.directions or clause.names or clause.here
        or clause.comparatives or clause.nouns
    )  # fmt: skip


def only_by(clause: Clause) -> bool:
    """Whether a clause says by how much, and nothing else."""
    by = [item.role for item in clause.quantities] == ["by"] and clause.quantities[0].value > 0.0
    return by and not (clause.verbs or clause.directions or clause.shares or clause.names or clause.targets)


def same_way(clause: Clause, commands: Sequence[Command], vocabulary: Vocabulary) -> list[Symbol]:
    """The direction of "another metre": that of the changes before. Raises UserError where there is one of each, or of
    another output alone.
    """
    (more,) = clause.directions
    goals = [goal for last in commands if isinstance(last, Move) for goal in last.goals]
    changes = [goal for goal in goals if goal.relative]
    values = Values(clause, vocabulary)
    outputs = {*clause.targets, *map(values.measured, clause.quantities)} - {None}
    ways = {goal.toward for goal in changes if goal.output in outputs or not outputs} - {0.0}
    if len(ways) > 1 or (not ways and any(goal.toward < 0.0 for goal in goals)):
        raise UserError(f"{more.text!r}: up, or down? say which")
    return [Symbol("U", ways.pop(), more.text)] if ways else [more]
