"""Questions are answered, and move nothing; what could be a command beside one is none."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.extensions.commander.language.command_interface import RigState
from hybrid_sysid_ros.extensions.commander.language.questions import answered, is_question
from hybrid_sysid_ros.rigs import rig as rigs


@pytest.mark.parametrize(
    "text",
    [
        "where is the beam now?", "what's the max speed I can ask for?", "how fast can it go",
        "could you tell me the position?", "qual é a velocidade agora", "onde está a viga?", "pode me dizer a posição?",
        "report speed and height", "position?", "Qual é o limite do drive?",
        "what are the throttle and the elevator set to?", "keep doing exactly what you are doing",
        "is the bit sticking? how fast is it and how fast is the top",
    ],
)  # fmt: skip
def test_a_question_is_one(text: str) -> None:
    assert is_question(text)


@pytest.mark.parametrize(
    "text",
    [
        "where is it? go to 2 V", "what is it and hold", "tell it to go to 2 V", "can you go up a bit", "why not stop",
        "where is it, then go home", "what about two volts", "qual é a posição, e depois volte", "stop, where is it",
        "what are they, then set to 0", "keep doing what you are doing, then go home", "home?", "2 V?", "up a bit?",
    ],
)  # fmt: skip
def test_what_may_be_a_command_is_no_question(text: str) -> None:
    assert not is_question(text)


def test_an_answer_says_where_the_rig_is_and_what_may_be_asked() -> None:
    rig = rigs.load("cam_beam")
    state = RigState(
        live=True, outputs={"position [V]": 1.5}, references={"position [V]": 2.0}, inputs={"drive [V]": 0.25}
    )
    line = answered(state, rig)
    assert "position 1.5 V of 2 V asked, from -8 to 8" in line
    assert "drive 0.25, from -10 to 10" in line
