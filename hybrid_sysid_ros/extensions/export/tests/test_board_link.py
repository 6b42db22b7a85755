"""A board on a noisy line: what is damaged does not count, and one that is silent, strange or started anew is named."""

import os
import pty
import struct
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from hybrid_sysid_ros.control.controller import Status
from hybrid_sysid_ros.extensions.export.board.driving import BoardController
from hybrid_sysid_ros.extensions.export.board.folder import PROTOCOL
from hybrid_sysid_ros.extensions.export.board.frames import FrameReceiver, encode
from hybrid_sysid_ros.extensions.export.board.link import BoardLink
from hybrid_sysid_ros.extensions.export.nodes.board_estimates import BoardEstimates
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.nodes.diagnostics import ERROR, Task
from hybrid_sysid_ros.nodes.messages import JointStates
from hybrid_sysid_ros.nodes.signal_layout import VALIDITY, SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import StampOrder
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import controller_model, defaults, mpc_problem, shipped
from hybrid_sysid_ros.support.errors import UserError

STATE, INPUT = [0.1, -0.2], 1.5


class PretendedBoard:
    """Answers as a board would, over a pseudo terminal. spoil: what becomes of each frame that it sends."""

    def __init__(self, *, seal=b"of the model", horizon=20):
        self.hand, own = pty.openpty()
        self.port = os.ttyname(own)
        self.identity = struct.pack("<6B", 8, 2, 1, 1, horizon, PROTOCOL) + seal
        self.spoil = lambda frame: frame
        self.mute, self.resets = False, 0
        self.received = FrameReceiver()
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self):
        while True:
            try:
                piece = os.read(self.hand, 4096)
            except OSError:
                return
            for content in self.received.receive(piece):
                self.answer(content[:1], content[1:3])

    def answer(self, kind, number):
        self.resets += kind == b"R"
        answers = {
            b"R": b"I" + number + self.identity,
            b"O": b"E" + number + b"\x01" + struct.pack("<5d", *STATE, *STATE, 0.0),
            b"D": b"C" + number + struct.pack("<BId", 2, 5000, INPUT),
        }
        if kind in answers and not self.mute:
            os.write(self.hand, self.spoil(encode(answers[kind])))

    def beat(self, alive):
        os.write(self.hand, encode(b"B\0\0" + struct.pack("<III", alive, 0, 0)))


@pytest.fixture(scope="module")
def problem():
    rig = load_rig("cam_beam")
    return mpc_problem(defaults(rig, "controller"), rig, controller_model(rig, rig.system))


def controller(board, problem, seal="of the model"):
    return BoardController(BoardLink(board.port), problem, seal=seal, patience=0.2)


def asked(driver):
    estimate = driver.observe(0.0, np.zeros(1), np.zeros(1))
    preview = np.zeros((driver.horizon, 1))
    return estimate, driver.control(np.zeros(2), np.zeros(1), np.array([0.7]), preview)


def test_noise_and_half_frames_between_answers_change_nothing(problem):
    board = PretendedBoard()
    driver, random = controller(board, problem), np.random.default_rng(0)
    board.spoil = lambda frame: random.bytes(40) + frame[: len(frame) // 2] + b"\0" + frame
    for _ in range(50):
        estimate, plan = asked(driver)
        np.testing.assert_array_equal(estimate.ahead, STATE)
        assert (plan.input[0], plan.status) == (INPUT, Status.ITERATED)
    assert driver.unanswered == 0
    assert driver.link.frames.wrong >= 50


def test_a_damaged_answer_counts_as_none_and_the_last_command_stays(problem):
    board = PretendedBoard()
    driver = controller(board, problem)
    board.spoil = lambda frame: frame[:5] + bytes([frame[5] ^ 0x10 or 1]) + frame[6:]
    estimate, plan = asked(driver)
    assert estimate is None
    assert (plan.input[0], plan.status) == (0.7, Status.HELD)
    assert driver.unanswered == 2


@pytest.mark.parametrize("there", [False, True])
def test_a_question_or_an_answer_that_was_damaged_once_is_sent_again_at_once(problem, there):
    """Waiting would cost ten periods; a board tells by its heart that it has found a damaged frame."""
    board = PretendedBoard()
    driver = controller(board, problem)
    driver.patience = 60.0
    lost = iter([True])

    def spoil(frame):
        if not next(lost, False):
            return frame
        return encode(b"B\0\0" + struct.pack("<III", 1, 0, 1)) if there else frame[:5] + b"\0"

    board.spoil = spoil
    assert asked(driver)[0].known
    assert (driver.unanswered, driver.link.frames.wrong, driver.link.board_wrong) == (0, not there, there)


def test_a_board_that_died_is_named_and_begins_anew_when_it_comes_back(problem):
    board = PretendedBoard()
    driver = controller(board, problem)
    assert board.resets == 1
    driver.link.heard, board.mute = 0.0, True  # as after seconds without a frame
    assert driver.observe(0.0, np.zeros(1), np.zeros(1)) is None
    assert "nothing from the board" in driver.trouble or "no board answers" in driver.trouble
    board.mute, driver._asked = False, 0.0
    assert driver.observe(0.0, np.zeros(1), np.zeros(1)).known
    assert (driver.trouble, driver.restarts) == ("", 1)


def test_a_board_that_was_only_waited_for_goes_on_with_its_past(problem):
    """A busy computer gives nobody time to write, which is no silence of the board."""
    board = PretendedBoard()
    driver = controller(board, problem)
    driver.link.heard = 0.0
    assert asked(driver)[0].known
    assert (board.resets, driver.restarts) == (1, 0)


def test_a_port_that_has_gone_is_looked_for_again_and_again(problem):
    """As that of a cable that was pulled out: there is nothing to open until it is put in again."""
    board, other = PretendedBoard(), PretendedBoard()
    driver = controller(board, problem)
    driver.link.port, driver.link.heard, board.mute = "/dev/gone", 0.0, True
    for _ in range(2):
        driver._asked = 0.0
        assert driver.observe(0.0, np.zeros(1), np.zeros(1)) is None
        assert driver.trouble
    driver.link.port, driver._asked = other.port, 0.0
    assert driver.observe(0.0, np.zeros(1), np.zeros(1)).known


def test_a_board_that_started_anew_is_asked_who_it_is(problem):
    board = PretendedBoard()
    driver, before = controller(board, problem), board.resets
    board.beat(9000)
    board.beat(100)
    while not driver.link.restarted:
        assert not driver.link.silent
    assert asked(driver)[0].known
    assert board.resets == before + 1


def test_diagnostics_that_look_whether_a_board_is_silent_take_no_answer_away(problem):
    """They are made in another thread, while an answer is waited for."""
    board, asking = PretendedBoard(), threading.Event()
    driver = controller(board, problem)

    def look():
        while not asking.is_set():
            assert not driver.link.silent

    other = threading.Thread(target=look)
    other.start()
    for _ in range(50):
        assert asked(driver)[0] is not None
    asking.set()
    other.join()
    assert driver.unanswered == 0


class Ears:
    """Stands in for the node that listens for a board: what it publishes, repeats and holds is counted."""

    signature, lockstep = "", True

    def __init__(self, problem):
        self.board, self.order = PretendedBoard(), StampOrder.NEW
        self.published: list[bytes] = []
        self.repeated = self.held = 0
        self.entry = self.output = self
        rig, model = load_rig("cam_beam"), load_model(shipped("cam_beam", "model"))
        self.driver = controller(self.board, problem)
        self.estimates = BoardEstimates(self.driver, rig, model)
        self.estimates.listen(self)  # type: ignore[arg-type]

    def validator(self, topic):
        return self

    def open(self, topic):
        return SimpleNamespace(publish=self.published.append)

    def listen(self, *given):
        return None

    def read(self, joints, slots, optional):
        return [0.0, INPUT]

    def admit(self, joints):
        return self.order

    def unpack(self, message):
        return None

    def repeat(self):
        self.repeated += 1

    def hold(self):
        self.held += 1

    def judged(self, name, troubles, count, **values):
        return Task(name=name)

    def hear(self, stamp, order=StampOrder.NEW):
        self.order = order
        self.estimates.on_measurement(JointStates("", stamp, [], ()))


def test_a_board_s_estimate_says_all_that_a_controller_reads_of_its_validity(problem):
    node = Ears(problem)
    node.hear(1)
    said = Slots([SignalPlace(name, "position") for name in VALIDITY])
    assert said.read(node.estimates._slots.names, node.estimates._writer._lists) == [0.0, 0.0, -1.0]
    assert len(node.published) == 1


def test_a_measurement_that_was_not_answered_is_asked_again_when_it_comes_again(problem):
    """A plant in lockstep publishes it until there is an answer: one lost frame must not end the loop."""
    node = Ears(problem)
    node.board.mute = True
    node.hear(1)
    assert (len(node.published), node.held) == (0, 1)
    node.board.mute = False
    node.hear(1, StampOrder.DUPLICATE)
    assert (len(node.published), node.repeated) == (1, 0)
    node.hear(1, StampOrder.DUPLICATE)
    assert (len(node.published), node.repeated) == (1, 1)


def test_a_board_that_dies_between_two_questions_is_reported(problem):
    node = Ears(problem)
    node.driver.link.heard = 0.0  # as after seconds without a frame
    (task,) = node.estimates.tasks()
    assert (task.level, "nothing from the board" in task.message) == (ERROR, True)


@pytest.mark.parametrize(
    ("given", "words"),
    [({"seal": b"of another"}, "loop of another model"), ({"horizon": 10}, "the board's horizon is 10")],
)
def test_a_stale_board_is_refused(problem, given, words):
    with pytest.raises(UserError, match=words):
        controller(PretendedBoard(**given), problem)


@pytest.mark.parametrize(("port", "words"), [("/dev/none", "can't be opened"), ("/dev/null", "is no serial port")])
def test_a_port_that_is_none_is_refused(port, words):
    with pytest.raises(UserError, match=words):
        BoardLink(port)


def test_a_rate_that_no_line_has_is_refused():
    with pytest.raises(UserError, match="is no rate"):
        BoardLink("/dev/null", baud=123)
