"""A corpus of sentences is read, or refused, as whoever reads them would."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.language.commands import Command, Follow, Home, Move, Sentence, Swing, Wait
from hybrid_sysid_ros.language.forecast import Simulator
from hybrid_sysid_ros.language.interpreter import Interpreter
from hybrid_sysid_ros.language.plan import Ability, plan_of
from hybrid_sysid_ros.language.vocabulary import Vocabulary
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError
from tests.language.corpus import CORPUS, Refused

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
        return {"do": "home"}
    if isinstance(command, Wait):
        return {"do": "wait", "seconds": command.seconds}
    if isinstance(command, Follow):
        return {"do": "follow", "name": command.name}
    if isinstance(command, Swing):
        return {
            "do": "square" if command.square else "swing", "between": (command.low, command.high),
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
        found, told = flat(understood(command, vocabulary, named)), flat(entry)
        assert found.keys() == told.keys()
        for key, value in told.items():
            assert found[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-9, abs=1e-12))
