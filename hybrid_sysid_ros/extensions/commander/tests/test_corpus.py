"""A corpus of sentences is read, or refused, as whoever reads them would."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.commands import (
    Command,
    Condition,
    Follow,
    Home,
    Move,
    Sentence,
    Swing,
    Wait,
)
from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.plan import plan_of
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.extensions.commander.nodes.waiting_commands import AwaitedCommand
from hybrid_sysid_ros.extensions.commander.tests.corpus import CORPUS
from hybrid_sysid_ros.extensions.commander.tests.readings import Refused
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError

SPEED, ACCELERATION = 10.0, 100.0
"""Of the ends of the set-points in a second: more than any of the rigs reaches, less than what is impossible."""


@cache
def interpreter(name: str) -> Interpreter:
    rig = rigs.load(name)
    model = Model(
        rig=rig.name, structure="gray", system=rig.system, sampling=Sampling(), names=(), covariance=np.zeros((0, 0)),
        training_range={},
    )  # fmt: skip
    return Interpreter.of(Simulator.of(rig, model))


def ability(vocabulary: Vocabulary) -> Ability:
    highest = np.array([output.high for output in vocabulary.outputs])
    return Ability(speed=SPEED * highest, acceleration=ACCELERATION * highest)


def understood(command: Command, vocabulary: Vocabulary, named: set[str]) -> dict[str, Any]:
    """A command as the corpus writes it; outputs have names where the corpus gives them."""

    def name(output: int) -> str:
        return vocabulary.outputs[output].name if named - {""} else ""

    if isinstance(command, Home):
        said = {"pace": command.pace, "seconds": command.seconds}
        return {"do": "home", **{key: value for key, value in said.items() if value}}
    if isinstance(command, Wait):
        return {"do": "wait", "seconds": command.seconds}
    if isinstance(command, Follow):
        return {"do": "follow", "name": command.name}
    if isinstance(command, Swing):
        return {
            "do": "swing" if command.shape == "sine" else command.shape, "between": (command.low, command.high),
            "hertz": command.frequency, "seconds": command.seconds, "output": name(command.output),
        }  # fmt: skip
    assert isinstance(command, Move)
    kind = "by" if command.goals[0].relative else "to"
    given = {key: getattr(command, key) for key in ("begin", "pace", "seconds", "rate", "hold")}
    return {
        "do": command.shape,
        kind: {name(goal.output): goal.value for goal in command.goals},
        **{key: value for key, value in given.items() if value},
    }


def flat(entry: dict[str, Any]) -> dict[str, Any]:
    """With one level."""
    found: dict[str, Any] = {}
    for key, value in entry.items():
        if isinstance(value, dict):
            found |= {f"{key}.{inner}": number for inner, number in value.items()}
        elif isinstance(value, tuple):
            found |= {f"{key}.{k}": number for k, number in enumerate(value)}
        else:
            found[key] = value
    return found


def read(name: str, text: str) -> Sentence:
    """A sentence that may be planned, too."""
    reader = interpreter(name)
    sentence = reader.read(text)
    vocabulary = reader.vocabulary
    plan_of(sentence.commands, np.zeros(len(vocabulary.outputs)), vocabulary, ability(vocabulary))
    return sentence


def test_the_corpus_is_as_large_as_it_should_be() -> None:
    assert len(CORPUS) >= 150
    assert len({(rig, text) for rig, text, _ in CORPUS}) == len(CORPUS)


@pytest.mark.parametrize(("name", "text", "expected"), CORPUS, ids=[text[:40] or "empty" for _, text, _ in CORPUS])
def test_a_sentence_is_understood_as_it_reads(name: str, text: str, expected: Any) -> None:
    if isinstance(expected, Refused):
        with pytest.raises(UserError) as refusal:
            read(name, text)
        assert expected.why in str(refusal.value)
        assert "\n" not in str(refusal.value)
        return
    sentence = read(name, text)
    vocabulary = interpreter(name).vocabulary
    wanted = [entry for entry in expected if entry["do"] != "stop"]
    assert sentence.stops == (len(wanted) < len(expected))
    assert len(sentence.commands) == len(wanted)
    for command, entry in zip(sentence.commands, wanted, strict=True):
        named = set(entry.get("to", entry.get("by", {entry.get("output", ""): 0})))
        found, reported = flat(understood(command, vocabulary, named)), flat(entry)
        assert found.keys() == reported.keys()
        for key, value in reported.items():
            assert found[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-9, abs=1e-12))


@pytest.mark.parametrize(
    ("name", "text", "output", "value"),
    [
        ("winged_cone", "when the height reaches 100 m set speed to 20 m/s", "height", 100.0),
        ("winged_cone", "quando a altura chegar a 100 m volte para casa", "height", 100.0),
        ("winged_cone", "go to 50 m and once at 100 m go to 20 m/s", "height", 100.0),
        ("wheel_motor", "stop when the speed passes 100 rpm", "speed", 100.0),
    ],
)
def test_a_condition_is_of_the_output_that_it_names(name: str, text: str, output: str, value: float) -> None:
    reader = interpreter(name)
    condition = reader.read(text).condition
    assert condition is not None
    assert condition.output is not None
    assert reader.vocabulary.outputs[condition.output].name == output
    assert condition.value == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "delay"),
    [
        ("go to 30 rpm, starting after 2 s", 2.0), ("go to 30 rpm, beginning in 5 s", 5.0),
        ("go to 30 rpm, starting 5 s from now", 5.0), ("go to 30 rpm, 5 s from now", 5.0),
        ("starting in 5 s, go to 30 rpm", 5.0),
        ("vá para 30 rpm, a começar daqui a 5 s", 5.0), ("vá para 30 rpm, começando depois de 5 s", 5.0),
    ],
)  # fmt: skip
def test_when_a_motion_starts_is_a_delay_of_it(text: str, delay: float) -> None:
    sentence = read("flexible_joint", text)
    assert (sentence.commands, sentence.condition) == ((), Condition(delay=delay))
    assert sentence.later is not None
    assert sentence.later.commands == read("flexible_joint", "go to 30 rpm").commands


def test_what_is_repeated_does_not_grow_without_end() -> None:
    reader, start = replace(interpreter("cam_beam")), np.zeros(1)
    reader.note(reader.read("hold 1 V then home"), start)
    reader.note(reader.read("repeat then repeat then repeat"), start)
    assert reader.last is not None
    assert len(reader.last.commands) == 6
    with pytest.raises(UserError, match="24 parts with those that are repeated: a command has 20 at most"):
        reader.read("repeat then repeat then repeat then repeat")


def test_what_changes_a_swing_changes_that_of_its_own_sentence() -> None:
    reader = replace(interpreter("cam_beam"))
    reader.note(reader.read("swing between -3 and 3 V at 1 Hz for 10 s"), np.zeros(1))
    first, second = reader.read("swing between -1 and 1 V at 0.5 Hz for 10 s, then double the amplitude").commands
    assert isinstance(first, Swing)
    assert second == replace(first, low=-2.0, high=2.0)


@pytest.mark.parametrize(
    ("text", "low", "frequency"),
    [
        ("double the period", -3.0, 0.5), ("set the period to 4 s", -3.0, 0.25), ("again at 2 Hz", -3.0, 2.0),
        ("set the peak to peak amplitude to 2 V", -1.0, 1.0), ("halve the amplitude", -1.5, 1.0),
    ],
)  # fmt: skip
def test_the_last_swing_changes_by_its_noun(text: str, low: float, frequency: float) -> None:
    reader = replace(interpreter("cam_beam"))
    reader.note(reader.read("swing between -3 and 3 V at 1 Hz for 10 s"), np.zeros(1))
    (changed,) = reader.read(text).commands
    assert isinstance(changed, Swing)
    assert (changed.low, changed.frequency) == pytest.approx((low, frequency))


@pytest.mark.parametrize(
    ("name", "text", "value", "side"),
    [
        ("winged_cone", "stop when the height drops below 100 m", 100.0, -1.0),
        ("winged_cone", "if height exceeds 300 m stop", 300.0, 1.0),
        ("winged_cone", "pare se a altura passar de 500 m", 500.0, 1.0),
        ("wheel_motor", "stop when it spins faster than 300 rpm", 300.0, 1.0),
        ("wheel_motor", "pare quando a velocidade cair abaixo de 20 rpm", 20.0, -1.0),
        ("cam_beam", "when it is above 1 V go to 0", 1.0, 1.0),
        ("cam_beam", "when the beam drops to 1 V go home", 1.0, 0.0),
    ],
)
def test_a_condition_may_be_a_side_of_a_value(name: str, text: str, value: float, side: float) -> None:
    condition = read(name, text).condition
    assert condition is not None
    assert condition.value == pytest.approx(value)
    assert condition.side == side


@pytest.mark.parametrize(("side", "due"), [(1.0, True), (-1.0, False), (0.0, False)])
def test_what_is_so_already_is_not_waited_for(side: float, due: bool) -> None:
    condition, ranges = Condition(output=0, value=1.0, side=side), interpreter("cam_beam").vocabulary.outputs
    awaited = AwaitedCommand(
        condition=condition,
        sentence=grammar.Sentence(text="", commands=(), stops=True),
        since=0.0,
        begin=np.array([2.0]),
    )
    assert awaited.is_due(0.1, np.array([2.0]), ranges, idle=True) is due


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("go to 3 V, and when it reaches 1 V go to 0", "passes 1 V on the way, where only a stop acts"),
        (
            "go to 2 V and stop when it drops below -1 V",
            "once position is below -1 V, within 30 s of its end, which the plan does not reach",
        ),
        ("go to 2 V and stop when it reaches 3 V", "which the plan does not reach: inputs to rest"),
        ("go to 3 V and stop when it reaches 1 V", "within 30 s of its end: inputs to rest"),
    ],
)
def test_a_value_on_the_way_is_said_as_it_is_watched(monkeypatch: pytest.MonkeyPatch, text: str, answer: str) -> None:
    monkeypatch.setattr(Simulator, "ability", Ability(speed=np.array([10.0]), acceleration=np.array([100.0])))
    reader = interpreter("cam_beam")
    sentence = reader.read(text)
    try:
        said = reader.story(sentence, reader.plan(sentence, np.zeros(1)))
    except UserError as refusal:
        said = str(refusal)
    assert answer in said


def test_back_after_a_condition_is_where_its_sentence_began(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not where the one before it began, which "undo" alone would mean."""
    monkeypatch.setattr(Simulator, "ability", Ability(speed=np.array([10.0]), acceleration=np.array([100.0])))
    reader = replace(interpreter("cam_beam"))
    reader.note(reader.read("go to 3 V"), np.zeros(1))
    sentence = reader.read("go to 2 V, once it is still go back to where it was")
    assert "from 2 V (2.6 deg) to 3 V (3.9 deg)" in reader.story(sentence, reader.plan(sentence, np.array([3.0])))


@pytest.mark.parametrize(
    "template",
    [
        "go to {} V at {} V/s", "ramp from {} V to {} V in {} s", "step between {} and {} V every {} s for {} s",
        "swing between {} and {} V at {} kHz", "swing between {} and {} V every {} s for {} periods",
        "swing by {} % at {} Hz for {} s", "hold {} MV for {} h",
    ],
)  # fmt: skip
def test_numbers_of_any_size_are_planned_soundly_or_refused(template: str) -> None:
    vocabulary, random = interpreter("cam_beam").vocabulary, Random(template)
    sizes = ["0", "-0", "5e-324", "1e-320", "1e-12", "1e-9", "-1", "0.001", "1", "3", "119", "1e5", "1e12", "1.7e308"]
    for _ in range(100):
        text = template.format(*(random.choice(sizes) for _ in range(template.count("{}"))))
        try:
            commands = interpreter("cam_beam").read(text).commands
            plan = plan_of(commands, np.zeros(len(vocabulary.outputs)), vocabulary, ability(vocabulary))
        except UserError:
            continue
        assert np.isfinite(plan.values).all(), text
        assert (np.diff(plan.times) > 0.0).all(), text
        assert plan.duration <= 120.0 + 1e-9, text


def test_what_follows_a_condition_goes_on_from_the_value_that_was_waited_for() -> None:
    """From rest, 5 lies above; from 20, where the command begins, it lies below."""
    reader = interpreter("flexible_joint")
    sentence = reader.read("when the link speed reaches 20 rpm drop it to 5")
    plan = plan_of(sentence.commands, np.zeros(2), reader.vocabulary, ability(reader.vocabulary))
    simulator = replace(reader.simulator)
    simulator.__dict__["ability"] = ability(reader.vocabulary)  # which takes a simulation
    assert "from 20 rpm" in replace(reader, simulator=simulator).story(sentence, plan)


def test_a_condition_may_be_of_an_output_that_nobody_steers() -> None:
    words = interpreter("drill_string").vocabulary
    sentence = grammar.read("when the top speed drops below 2 rad/s, go to 6 rad/s", words)
    assert sentence.condition is not None
    assert sentence.condition.output is not None
    assert words.outputs[sentence.condition.output].name == "top_speed"
    assert (sentence.condition.value, sentence.condition.side) == (2.0, -1.0)
