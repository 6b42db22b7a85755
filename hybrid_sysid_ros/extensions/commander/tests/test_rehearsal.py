"""Rehearsals: every shipped rig carries a sentence out on its shipped model, whatever states that model has."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support import extensions


@cache
def interpreter(name: str) -> Interpreter:
    rig = rigs.load(name)
    return Interpreter.of(Simulator.of(rig, load(shipped(name, "model"), rig=rig.source), policy="exact"))


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
    reply = Rehearsal(interpreter(name)).say(text)
    assert reply.accepted, reply.line
    assert all(value >= 0.0 for key, value in reply.values.items() if key.startswith(("margin", "error")))


@pytest.mark.parametrize(("text", "beyond"), [("go to 2 V", False), ("go to 8 V", True)])
def test_a_plan_that_leaves_what_the_model_was_trained_on_says_how_far(text: str, beyond: bool) -> None:
    """The simulation of a model says nothing of places where its records never were."""
    made = interpreter("cam_beam")
    reply = Rehearsal(made).say(text)
    said = {key: value for key, value in reply.values.items() if "trained" in key}
    assert bool(said) == beyond
    if beyond:
        end = np.float64(made.simulator.model.training_range["position"][1])
        far = 8.0 - float(made.simulator.rig.display[0].shown(end))
        assert said["position beyond what the model was trained on [V]"] == pytest.approx(far, abs=0.3)


def test_without_what_reads_pictures_one_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(extensions, "targets", lambda kind: {})
    (tmp_path / "goal.jpg").touch()
    made = interpreter("cam_beam")
    files = replace(made.files, folder=str(tmp_path))
    reply = Rehearsal(replace(made, files=files, eyes=replace(made.eyes))).say("look like goal.jpg")
    assert not reply.accepted
    assert "no extension that reads pictures is installed" in reply.line


def test_an_output_that_belongs_at_0_hinders_no_way_home() -> None:
    """The path angle is weighed but never sent anywhere: after a stop it is told to stay where it happened to be."""
    cone = interpreter("winged_cone")
    rest = cone.simulator.rest
    place = [item.name for item in cone.simulator.model.system.states].index("height")
    for height in (0.0, 50.0):
        plan = cone.plan(cone.read("home"), np.array([0.0, 0.0145, height, 0.0, 0.0]))
        assert np.isfinite(plan.times).all()
        assert not plan.values[-1].any()
        begin = replace(rest, state=np.where(np.arange(rest.state.size) == place, height, 0.0))
        cone.forecast(plan, begin)  # which no UserError refuses
