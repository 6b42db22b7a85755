"""Staircases: their levels by arithmetic, and what their words leave open."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.commands import Home, Repeat
from hybrid_sysid_ros.extensions.commander.tests.test_plan import BEAM, plan
from hybrid_sysid_ros.support.errors import UserError


@pytest.mark.parametrize(
    ("text", "begins", "levels", "each"),
    [
        ("from 0 to 2 V in 4 steps of 2 s each", 0.0, [0.5, 1.0, 1.5, 2.0], 2.0),
        ("from 0 to 2 V in steps of 0.5 V, 3 s each", 0.0, [0.5, 1.0, 1.5, 2.0], 3.0),
        ("staircase from 2 to -1 V with 3 steps of 2 s", 2.0, [1.0, 0.0, -1.0], 2.0),
        ("from 0 to 1 V in steps of 0.4 V every 2 s", 0.0, [0.4, 0.8, 1.0], 2.0),
        ("de 0 a 2 V em 4 degraus de 3 s cada", 0.0, [0.5, 1.0, 1.5, 2.0], 3.0),
    ],
)
def test_stairs_stay_as_long_at_each_level(text: str, begins: float, levels: list[float], each: float) -> None:
    made = plan(text, start=begins)
    middles = made.duration - each * (np.arange(len(levels))[::-1] + 0.5)
    np.testing.assert_allclose(made(middles)[:, 0], levels, atol=1e-12)
    np.testing.assert_allclose(made(middles[0] - each)[0], begins)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("up 0.5 V every 2 s until 3 V", 3.0),
        ("go up in steps of 0.5 V every 2 s, 4 times", 3.0),
        ("down 0.5 V every 2 s, 4 times", -1.0),
        ("suba 0,5 V a cada 2 s até 3 V", 3.0),
    ],
)
def test_stairs_begin_where_the_rig_is(text: str, end: float) -> None:
    made = plan(text, start=1.0)
    assert made.values[-1, 0] == pytest.approx(end)
    assert made.duration == pytest.approx(8.0, abs=0.01)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("go to 2 V in 4 steps", "how long is each step"),
        ("up 0.5 V every 2 s", "how many steps"),
        ("stairs to 2 V, 3 s each", "how high is each step"),
        ("up in steps of 0.5 V every 2 s until -3 V", "the other way"),
        ("from 0 to 20 V in 4 steps of 2 s each", "out of reach"),
    ],
)
def test_stairs_ask_for_what_was_not_said(text: str, why: str) -> None:
    with pytest.raises(UserError, match=why):
        plan(text)


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        ("go to 1 V and back 3 times", [1, 0] * 3),
        ("go to 1 V, wait 2 s, go to -1 V, repeat 2 times", [1, 1, -1] * 2),
        ("three times: go to 1 V, then -1 V", [1, -1] * 3),
        ("up 1 V and back down, twice", [1, 0] * 2),
        ("repeat twice: go to 1 V, go to 0", [1, 0] * 2),
        ("up 1 V 3 times", [1, 2, 3]),
        ("up 1 V, wait 1 s, 3 times", [1, 1, 2, 2, 3, 3]),
        ("vá para 1 V e volte três vezes", [1, 0] * 3),
    ],
)
def test_parts_are_repeated_in_their_order(text: str, ends: list[int]) -> None:
    """By the ends of all parts, of which each is one line of the story."""
    sentence = grammar.read(text, BEAM)
    assert len(sentence.commands) == len(ends)
    assert plan(text).values[-1, 0] == pytest.approx(ends[-1])
    reached = [value for value, _ in zip(plan(text).values[:, 0], range(4000), strict=False)]
    assert {float(end) for end in ends} <= {round(value, 9) for value in reached}


@pytest.mark.parametrize("text", ["repeat 3 times and then home", "3 times, then home"])
def test_what_was_carried_out_before_is_repeated_before_what_follows(text: str) -> None:
    again, home = grammar.read(text, BEAM).commands
    assert isinstance(again, Repeat)
    assert again.times == 3
    assert isinstance(home, Home)


@pytest.mark.parametrize(
    "text", ["go to 1 V 3 times", "go home, then up 1 V 3 times", "3 times: once it is still, home"]
)
def test_what_is_repeated_is_never_guessed(text: str) -> None:
    with pytest.raises(UserError, match="times"):
        grammar.read(text, BEAM)
