"""What people call the parts of a rig is in the rig's file, and means something at that rig alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.commands import Home, Move
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary, spoken_names
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError


@pytest.mark.parametrize(
    ("rig", "text"),
    [
        ("cam_beam", "once the beam is still, go home"),
        ("cam_beam", "quando a viga parar, centralize"),
        ("wheel_motor", "quando a roda parar, centralize"),
        ("drill_string", "once the bit is still, go home"),
    ],
)
def test_a_condition_may_name_the_rig_or_what_moves(rig: str, text: str) -> None:
    sentence = grammar.read(text, Vocabulary.of(rigs.load(rig)))
    assert sentence.condition is not None
    assert sentence.condition.settled
    assert sentence.later is not None
    assert sentence.later.commands == (Home(),)


def test_names_of_one_rig_mean_nothing_at_another() -> None:
    with pytest.raises(UserError, match="unknown word 'viga'"):
        grammar.read("leve a viga para 10 rpm", Vocabulary.of(rigs.load("wheel_motor")))


def test_left_is_where_the_right_wheel_drives_the_robot() -> None:
    rig = rigs.load("balancing_robot")
    vocabulary, system = Vocabulary.of(rig), rig.system
    (command,) = grammar.read("turn left 30 degrees", vocabulary).commands
    assert isinstance(command, Move)
    (goal,) = command.goals
    assert vocabulary.outputs[goal.output].name == "yaw"
    *_, turned = system.law([0.0] * len(system.states), [0.0, 50.0])  # the right wheel
    assert goal.relative
    assert goal.value * float(turned) > 0.0


@pytest.mark.parametrize(
    ("names", "why"),
    [
        ({"pt": {"boom": ["lança"]}}, "unknown key 'boom'"),
        ({"de": {"beam": ["balken"]}}, "unknown key 'de'"),
        ({"pt": {"beam": "viga"}}, "a list of single words"),
        ({"pt": {"beam": [["viga"]]}}, "a list of single words"),
        ({"pt": {"beam": ["viga de aço"]}}, "a list of single words"),
        ({"pt": {"beam": ["Não"]}}, "means something in all commands"),
        ({"pt": ["viga"]}, "pt needs keys"),
    ],
)
def test_what_can_be_no_name_is_refused_with_its_place(names: Any, why: str) -> None:
    rig = rigs.load("cam_beam")
    with pytest.raises(UserError, match=why) as refusal:
        spoken_names(replace(rig, content={**rig.content, "names": names}))
    assert str(refusal.value).startswith(f"{rig.file}: names")
