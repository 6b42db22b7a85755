"""A board in the emulator closes the loop of a plant in Python, over a pseudo terminal with noise."""

import json
import os

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.control.controller import Status
from hybrid_sysid_ros.extensions.export.board import folder
from hybrid_sysid_ros.extensions.export.board.driving import BoardController
from hybrid_sysid_ros.extensions.export.board.emulator import BoardEmulator
from hybrid_sysid_ros.extensions.export.board.frames import encode
from hybrid_sysid_ros.extensions.export.board.link import BoardLink
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.extensions.export.unit.replay import recorded
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError

LACKING = "; ".join(f"{name}: {advice}" for name, advice in folder.missing_tools().items())
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(LACKING), reason=f"needs {LACKING}")]
PATIENCE = 30.0
"""Of a busy machine [s]; nothing here depends on times."""


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    rig, model = load_rig("cam_beam"), hs.load_model(shipped("cam_beam", "model"))
    place, settings = tmp_path_factory.mktemp("board") / "beam", {"real_time": True}
    _, found = folder.export_board(rig, model, place, board="m7", settings=settings, seal=model.seal)
    return rig, model, place, found


def test_the_processor_answers_as_python_and_is_counted(beam):
    found = beam[-1]
    assert (found.wrong, found.difference <= 1e-9) == (0, True)
    assert 0 < found.median <= found.percentile <= found.most
    assert json.loads((beam[2] / folder.MANIFEST).read_text())["emulated"]["median"] == found.median


def test_a_loop_over_a_noisy_line_is_that_of_python_until_the_board_dies(beam):
    rig, model, place, _ = beam
    python, random = loop_in_python(rig, model, {"real_time": True}), np.random.default_rng(0)
    questions, answers = recorded(rig, python, 60)
    with BoardEmulator(place) as board:
        link = BoardLink(board.port)
        driver = BoardController(link, python.mpc.problem, seal=model.seal, patience=PATIENCE)
        sent = python.command * 0.0 + [actuator.rest for actuator in rig.actuators]
        for question, answer in zip(questions, answers, strict=True):
            if random.random() < 0.3:  # noise, and half a frame
                garbage = random.bytes(20) + encode(b"O" + random.bytes(30))[:15]
                os.write(link._line, garbage + b"\0")
            estimate = driver.observe(question.time, question.outputs, question.applied)
            assert estimate is not None
            np.testing.assert_allclose(estimate.ahead, answer.ahead, rtol=0, atol=1e-9)
            plan = driver.control(estimate.ahead, estimate.disturbance, sent, question.preview)
            np.testing.assert_allclose(plan.input, answer.inputs, rtol=0, atol=1e-9)
            driver.prepare(python.estimator.period)
            sent = plan.input
        assert driver.ticks > 0
        while not link.board_wrong:  # until its heart has beaten
            assert not link.silent or link.board_wrong
        board.stop()
        driver.patience = 0.1
        assert driver.observe(1.0, questions[0].outputs, questions[0].applied) is None
        plan = driver.control(np.zeros(2), np.zeros(1), sent, questions[0].preview)
        assert (plan.status, plan.input) == (Status.HELD, sent)


def test_a_board_with_another_model_is_refused(beam):
    _, model, place, _ = beam
    python = loop_in_python(beam[0], model, {"real_time": True})
    with BoardEmulator(place) as board, pytest.raises(UserError, match="loop of another model"):
        BoardController(BoardLink(board.port), python.mpc.problem, seal="another", patience=PATIENCE)
