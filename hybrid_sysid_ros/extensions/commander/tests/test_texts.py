"""Random texts: none is a traceback, none plans beyond the limits of its rig."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from benchmarks.commander import texts
from hybrid_sysid_ros.extensions.commander.language.commands import Adjust, Repeat, Undo
from hybrid_sysid_ros.extensions.commander.language.plan import plan_of
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError


class TextReading:
    """An interpreter that simulates nothing: its rig's abilities are given."""

    def __init__(self, name: str) -> None:
        from hybrid_sysid_ros.extensions.commander.language import grammar

        self.grammar, self.vocabulary = grammar, Vocabulary.of(rigs.load(name))
        highest = np.array([output.high for output in self.vocabulary.outputs])
        self.ability = Ability(speed=3.0 * highest, acceleration=30.0 * highest)

    def plan(self, text: str) -> ReferencePlan | None:
        try:
            sentence = self.grammar.read(text, self.vocabulary)
            if sentence.is_stop or any(isinstance(item, Repeat | Undo | Adjust) for item in sentence.commands):
                return None  # an interpreter repeats what was said before, and here nothing was
            start = np.zeros(len(self.vocabulary.outputs))
            return plan_of(sentence.commands, start, self.vocabulary, self.ability)
        except UserError:
            return None


@pytest.mark.parametrize("name", ["cam_beam", "flexible_joint", "wheel_motor", "winged_cone"])
def test_no_text_plans_beyond_the_limits(name: str) -> None:
    reading, random, planned = TextReading(name), Random(name), 0
    for _ in range(400):
        plan = reading.plan(text := texts.text(random, reading.vocabulary))
        if plan is not None:
            planned += 1
            assert texts.broken(plan, reading.vocabulary, reading.ability) == [], text
    assert planned > 20  # or the test says nothing
