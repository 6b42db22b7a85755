"""Rehearsals: every shipped rig carries a sentence out on its shipped model, whatever states that model has."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.language.rehearsal import Rehearsal
from hybrid_sysid_ros.rigs import rig as rigs


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("cam_beam", "go to 1 V then home"),
        ("flexible_joint", "go to 20 rpm"),
        ("wheel_motor", "go to 60 rpm"),
        ("drill_string", "set bit speed to 3 rad/s"),
        ("winged_cone", "set height to 100 m"),
    ],
)
def test_a_shipped_model_carries_a_sentence_out(name: str, text: str) -> None:
    reply = Rehearsal.of(rigs.load(name), model="", policy="exact", folder="", layers="").say(text)
    assert reply.accepted, reply.line
    assert all(value >= 0.0 for key, value in reply.values.items() if key.startswith(("margin", "error")))
