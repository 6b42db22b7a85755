"""Descriptions: commands in words, as they were interpreted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Follow,
    Goal,
    Home,
    Move,
    Repeat,
    Sentence,
    Swing,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary


def description(sentence: Sentence, vocabulary: Vocabulary) -> str:
    """A sentence as it was understood."""
    if sentence.emergency:
        return "emergency stop"
    parts = [_TELLERS[type(command)](command, vocabulary) for command in sentence.commands]
    return ", then ".join([*parts, *(["stop"] if sentence.stops else [])])


def _goal(goal: Goal, vocabulary: Vocabulary) -> str:
    output = vocabulary.outputs[goal.output]
    name = f"{output.name} " if len(vocabulary.tracked) > 1 else ""
    return f"{name}{'by' if goal.relative else 'to'} {goal.value:.4g} {output.unit}".rstrip()


def _move(command: Move, vocabulary: Vocabulary) -> str:
    output = vocabulary.outputs[command.goals[0].output]
    words = [{"smooth": "go", "straight": "ramp", "step": "step"}[command.shape]]
    words += [f"from {command.begin:.4g} {output.unit}"] if command.begin is not None else []
    words += [" and ".join(_goal(goal, vocabulary) for goal in command.goals)]
    words += [command.pace] if command.pace else []
    words += [f"in {command.seconds:.4g} s"] if command.seconds is not None else []
    words += [f"at {command.rate:.4g} {output.unit}/s"] if command.rate is not None else []
    words += [f"as {command.picture} shows"] if command.picture else []
    return " ".join([*words, *([f"and stay for {command.hold:.4g} s"] if command.hold else [])])


def _swing(command: Swing, vocabulary: Vocabulary) -> str:
    output = vocabulary.outputs[command.output]
    name = f"{output.name} " if len(vocabulary.tracked) > 1 else ""
    verb = "step" if command.square else "swing"
    where = " about where it is" if command.relative else ""
    return (
        f"{verb} {name}between {command.low:.4g} and {command.high:.4g} {output.unit}{where} at "
        f"{command.frequency:.4g} Hz for {command.seconds:.4g} s"
    )


_TELLERS: Mapping[type[Command], Callable[[Any, Vocabulary], str]] = {
    Home: lambda command, vocabulary: f"go home {command.pace}".rstrip(),
    Repeat: lambda command, vocabulary: "repeat",
    Wait: lambda command, vocabulary: f"stay for {command.seconds:.4g} s" if command.seconds else "stay",
    Move: _move,
    Swing: _swing,
    Follow: lambda command, vocabulary: f"follow {command.name}",
}
