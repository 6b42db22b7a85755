"""Words: sentences for five rigs, each with what it asks for, and what the commander makes of it."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.commander import texts
from benchmarks.meaning.rows import Row
from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Adjust,
    Command,
    Follow,
    Home,
    Move,
    Repeat,
    Sentence,
    Staircase,
    Swing,
    Undo,
    Wait,
    met,
)
from hybrid_sysid_ros.extensions.commander.language.goals import BIT
from hybrid_sysid_ros.extensions.commander.language.plan import plan_of
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError

RIGS = {
    "beam": "cam_beam",
    "joint": "flexible_joint",
    "drill": "drill_string",
    "wheel": "wheel_motor",
    "cone": "winged_cone",
    "robot": "balancing_robot",
}
WAY_IN = re.compile(
    r"\b(say|do you mean|did you mean|known are|give|take|leave|name|stay within|write|begin|join|commands ask"
    r"|they steer|it tracks|needs?|diga)\b"
)
"""By which a refusal says what to write instead."""
LISTS = (
    "sentences", "kept_sentences", "strangers", "later_strangers", "fresh_strangers", "plain_strangers",
    "plainer_strangers", "newest_strangers",
)  # fmt: skip
DONE, CLEAR, STOPPED = 0.85, 0.90, 1.0
"""Asked: sensible sentences that are done, refusals that name the way in, stops that stop."""


@dataclass(frozen=True)
class Example:
    """A sentence and the outcomes that are right."""

    rig: str
    text: str
    right: tuple[str, ...]
    adversarial: bool


def examples(name: str = "sentences.txt") -> list[Example]:
    """Those of a file."""
    found = []
    for line in Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            rig, text, *right = (part.strip() for part in line.split(" | "))
            outcomes = tuple(each.strip() for part in right for each in part.split("|"))
            found.append(Example(rig.lstrip("! "), text, outcomes, line.startswith("!")))
    return found


@cache
def vocabulary(rig: str) -> Vocabulary:
    """Of a rig by its short name."""
    return Vocabulary.of(rigs.load(RIGS[rig]))


@cache
def ability(rig: str) -> Ability:
    """More than any rig reaches, so that words alone are judged."""
    highest = np.array([output.high for output in vocabulary(rig).outputs])
    return Ability(speed=10.0 * highest, acceleration=100.0 * highest)


def outcome(example: Example) -> tuple[str, str]:
    """What the commander makes of a sentence, and the refusal."""
    words = vocabulary(example.rig)
    try:
        sentence = grammar.read(example.text, words)
        if sentence.asks:
            return "ask", ""
        if not sentence.is_stop:
            planned(sentence, words, example.rig)
    except UserError as refusal:
        return "no", str(refusal)
    return "; ".join(told(sentence, words)), ""


def planned(sentence: Sentence, words: Vocabulary, rig: str) -> None:
    """Plan all that needs no memory, from a tenth of the set-points. Raises UserError for what is out of reach."""
    start = np.array([0.1 * output.high if output.moves else 0.0 for output in words.outputs])
    while True:
        commands = list[Command]()
        for item in sentence.commands:
            moved = any(not isinstance(before, Wait) for before in commands)  # from where it goes back
            commands += (
                [item] if not isinstance(item, Repeat | Adjust) and (moved or not isinstance(item, Undo)) else []
            )
        start = plan_of(commands, start, words, ability(rig)).values[-1]
        if sentence.later is None:
            return
        assert sentence.condition is not None
        start, sentence = met(sentence.condition, start), sentence.later


def told(sentence: Sentence, words: Vocabulary) -> list[str]:
    """A sentence as sentences.txt writes it."""
    if sentence.emergency:
        return ["estop"]
    found = [part for command in sentence.commands for part in written(command, words)] + ["stop"] * sentence.stops
    if sentence.later is not None and sentence.condition is not None:
        condition, (first, *rest) = sentence.condition, told(sentence.later, words)
        when = f"after {condition.delay:.6g}" if condition.delay else "once"
        when = when if condition.output is None else f"reach {name(condition.output, words)}{condition.value:.6g}"
        found += [f"{when}: {first}", *rest]
    return found


def name(output: int, words: Vocabulary, mark: str = " ") -> str:
    """Of an output where there are several."""
    return f"{words.outputs[output].name}{mark}" if len(words.tracked) > 1 or output not in words.tracked else ""


def written(command: Command, words: Vocabulary) -> list[str]:
    """One command."""
    if isinstance(command, Wait):
        return [f"wait {command.seconds:.6g}"]
    if isinstance(command, Home):
        said = ["home", command.pace, f"in {command.seconds:.6g}" if command.seconds is not None else ""]
        return [" ".join(filter(None, said)), *([f"wait {command.hold:.6g}"] if command.hold else [])]
    if isinstance(command, Follow):
        return [f"follow {command.name}"]
    if isinstance(command, Undo):
        return ["undo" if command.seconds is None else f"undo in {command.seconds:.6g}"]
    if isinstance(command, Staircase):
        return [stepped(command, words)]
    if isinstance(command, Repeat):
        times = str(command.times) if command.times > 1 else ""
        long = f"for {command.seconds:.6g}" if command.seconds is not None else ""
        return [" ".join(filter(None, ["repeat", times, command.pace, long]))]
    if isinstance(command, Adjust):
        sign = {"to": "", "by": "+" if command.value >= 0.0 else "", "times": "x"}[command.how]
        noun = {"amplitude": "amp ", "frequency": "freq ", "speed": ""}[command.noun]
        return [f"{noun}{sign}{command.value:.6g}"]
    if isinstance(command, Swing):
        kind = "swing" if command.shape == "sine" else command.shape
        ends = f"{kind} {name(command.output, words)}{command.low:.6g} {command.high:.6g} {command.frequency:.6g}"
        if command.last_frequency:
            ends = f"chirp {command.low:.6g} {command.high:.6g} {command.frequency:.6g} {command.last_frequency:.6g}"
        return [f"{ends} {command.seconds:.6g}"]
    assert isinstance(command, Move)
    return moved(command, words)


def stepped(command: Staircase, words: Vocabulary) -> str:
    """A staircase: from where, to where, how many steps or how high, and how long each."""
    said = ["stairs", name(command.output, words)]
    said += [f"from {command.begin:.6g}"] if command.begin is not None else []
    said += [f"{'by' if command.relative else 'to'} {command.end:.6g}"] if command.end is not None else []
    said += [f"rise {(command.toward or 1.0) * command.rise:.6g}"] if command.rise is not None else []
    said += [f"steps {command.count}"] if command.count else []
    return " ".join(filter(None, [*said, f"each {command.seconds:.6g}"]))


def moved(command: Move, words: Vocabulary) -> list[str]:
    """A move, and its hold as a wait."""
    goals = []
    for goal in sorted(command.goals, key=lambda goal: goal.output):
        factor = "x" if goal.share else "+" if goal.relative and goal.value >= 0.0 else ""
        relative = " rel" if goal.relative and goal.value < 0.0 else ""
        goals.append(f"{name(goal.output, words, '=')}{factor}{goal.value:.6g}{relative}")
    said = [{"smooth": "", "straight": "ramp", "step": "step"}[command.shape], *goals]
    said += [f"from {command.begin:.6g}"] if command.begin is not None else []
    said += [f"in {command.seconds:.6g}"] if command.seconds is not None else []
    said += [f"at {command.rate:.6g}"] if command.rate is not None else []
    said += [command.pace] if command.pace else []
    return [" ".join(filter(None, said)), *([f"wait {command.hold:.6g}"] if command.hold else [])]


def alike(found: str, right: str, words: Vocabulary) -> bool:
    """Whether two outcomes are the same, numbers within .1 %."""
    return _normal(found, words) == _normal(right, words)


def _normal(text: str, words: Vocabulary) -> list[list[object]]:
    """Parts of tokens; a home of one output is its 0, a hold a wait, and a wait of 0 at the end nothing."""
    span = 0.5 * (words.outputs[words.tracked[0]].high - words.outputs[words.tracked[0]].low)
    text = re.sub(r"\bbit([+-])", lambda match: f"{'+' if match[1] == '+' else '-'}{BIT * span:g}" + (
        " rel" if match[1] == "-" else ""), text)  # fmt: skip
    text = re.sub(r" hold (\S+)", r"; wait \1", text)
    text = text if len(words.tracked) > 1 else re.sub(r"\bhome\b", "0", text)
    parts = [sorted(map(_token, part.split()), key=str) for part in re.split(r"[;:]", text) if part.strip()]
    while len(parts) > 1 and parts[-1] == sorted([_token("wait"), _token("0")], key=str):
        parts.pop()
    return parts


def _token(token: str) -> object:
    """A number to three digits, or the word."""
    match = re.fullmatch(r"((?:\w+=)?[x+]?)(-?[\d.e+-]+)(?:/([\d.]+))?", token)
    if match is None:
        return token
    try:
        value = float(match[2]) / float(match[3] or 1.0)
    except ValueError:
        return token
    return f"{match[1]}{0.0 if math.isclose(value, 0.0, abs_tol=1e-9) else float(f'{value:.4g}')}"


def judged(chosen: Sequence[Example]) -> dict[str, Any]:
    """Counts of what came of sentences, and those that were wrong."""
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    missed: list[str] = []
    dim: list[str] = []
    for example in chosen:
        found, refusal = outcome(example)
        words, right = vocabulary(example.rig), example.right
        stop = right[0] in ("stop", "estop")
        sensible = "no" not in right and not stop
        hit = found != "no" and any(alike(found, each, words) for each in right if each != "no")
        hit = hit or (found in ("no", "ask") and "no" in right)  # an answer moves nothing
        counts["sentences"] += 1
        counts["stops"] += stop
        counts["sensible"] += sensible
        counts["stops that stop"] += stop and hit
        counts["sensible done"] += sensible and hit
        counts["refusals"] += bool(refusal)
        counts["refusals with a way in"] += bool(refusal) and WAY_IN.search(refusal) is not None
        if refusal and not WAY_IN.search(refusal):
            dim.append(f"{example.rig} {example.text!r}: {refusal}")
        counts["stops in place of a motion"] += sensible and not hit and found in ("stop", "estop")
        if not hit and found != "no":
            wrong.append(f"{example.rig} {example.text!r}: {found}, not {' or '.join(right)}")
        elif not hit:
            missed.append(f"{example.rig} {example.text!r}: {refusal or found}; not {' or '.join(right)}")
    return {**counts, "wrong": wrong, "missed": missed, "without a way in": dim}


def random_texts(count: int, seed: int) -> dict[str, int]:
    """Random texts at all rigs: those that were planned, and those whose plans leave a limit or end in a traceback."""
    found = {"texts": 0, "planned": 0, "beyond": 0, "tracebacks": 0}
    for rig in RIGS:
        words, random = vocabulary(rig), Random(f"{seed} {rig}")
        for _ in range(count // len(RIGS)):
            start = np.array([0.5 * random.uniform(o.low, o.high) if o.tracked else 0.0 for o in words.outputs])
            said = texts.text(random, words)
            found["texts"] += 1
            try:
                sentence = grammar.read(said, words)
                commands = [item for item in sentence.commands if not isinstance(item, Repeat | Undo | Adjust)]
                plan = plan_of(commands, start, words, ability(rig))
                found["planned"] += bool(commands)
                found["beyond"] += bool(texts.broken(plan, words, ability(rig)))
            except UserError as refusal:
                found["tracebacks"] += "\n" in str(refusal)
            except Exception:
                found["tracebacks"] += 1
    return found


def measured(*, count: int = 100_000, seed: int = 0) -> tuple[Mapping[str, Any], list[Row]]:
    """All sentences, and random texts."""
    random = random_texts(count, seed)
    found: dict[str, Any] = {"random": random}
    rows = [
        Row("random texts beyond the limits", 0, random["beyond"], at_most=True),
        Row("tracebacks of random texts", 0, random["tracebacks"], at_most=True),
    ]
    for name in LISTS:
        found[name] = one = judged(examples(f"{name}.txt"))
        rows += [
            Row(f"{name}: moved otherwise than said", 0, len(one["wrong"]), at_most=True),
            Row(f"{name}: share of the sensible that is done", DONE, one["sensible done"] / one["sensible"]),
            Row(f"{name}: share of refusals with a way in", CLEAR, one["refusals with a way in"] / one["refusals"]),
            Row(f"{name}: share of stops that stop", STOPPED, one["stops that stop"] / one["stops"]),
        ]
    return found, rows
