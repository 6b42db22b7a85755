"""The validator of a topic: which messages, stamps and publishers are believed, and what is counted of the rest."""

from __future__ import annotations

import math
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.messages import SECOND, JointStates
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import FORMS, LARGEST, MessageValidator, Reason, StampOrder
from tests.node_bench import joint

MS = SECOND // 1000


class Gate:
    """A validator whose clocks the test sets."""

    def __init__(self, *, timed: bool = True, **options: Any) -> None:
        self.now, self.steady = 1000 * SECOND, 5 * SECOND
        given = {"ahead": 20 * MS, "behind": 500 * MS, "silence": 500 * MS, **options}
        self.validator = MessageValidator(
            JointState, clock=(lambda: self.now) if timed else None, steady=lambda: self.steady, **given
        )

    def say(self, stamp: int, source: str = "") -> StampOrder | None:
        return self.validator.admit(JointStates(source, stamp, ["beam"], ([], [], [])))

    def wait(self, time: int) -> None:
        self.now += time
        self.steady += time


def test_stamps_are_believed_near_the_clock_only() -> None:
    gate = Gate()
    assert gate.say(gate.now - 5 * MS) is StampOrder.NEW
    for _ in range(20):  # .9 s ahead, again and again
        assert gate.say(gate.now + 900 * MS) is None
        gate.wait(5 * MS)
        assert gate.say(gate.now - 5 * MS) is StampOrder.NEW
    assert gate.say(gate.now - 2 * SECOND) is None  # nor does an old one begin anything anew
    assert gate.say(0) is None
    assert gate.validator.dropped == {Reason.AHEAD: 20, Reason.LONG_PAST: 2}


def test_a_stamp_comes_again_or_late() -> None:
    gate = Gate()
    gate.say(gate.now)
    assert gate.say(gate.now) is StampOrder.DUPLICATE
    assert gate.say(gate.now - 10 * MS) is StampOrder.LATE
    assert gate.say(gate.now + MS) is StampOrder.NEW


def test_time_begins_anew_where_the_clock_went_back() -> None:
    gate = Gate()
    gate.say(gate.now)
    gate.now -= 60 * SECOND
    assert gate.say(gate.now) is StampOrder.RESTART
    assert gate.say(gate.now + 5 * MS) is StampOrder.NEW


@pytest.mark.parametrize("back", [50 * MS, 200 * MS, 500 * MS, 950 * MS])
def test_time_begins_anew_where_the_clock_was_set_back_a_little(back: int) -> None:
    """Otherwise nothing would be new until the clock has come back to where it was."""
    gate = Gate()
    for _ in range(3):
        assert gate.say(gate.now) is StampOrder.NEW
        gate.wait(5 * MS)
    assert gate.say(gate.now - back) in {StampOrder.LATE, None}, "the message was sooner than the clock"
    gate.now -= back
    assert gate.say(gate.now) is StampOrder.RESTART
    gate.wait(5 * MS)
    assert gate.say(gate.now) is StampOrder.NEW


def test_a_clock_that_stands_a_little_makes_no_late_message_a_new_beginning() -> None:
    gate = Gate()
    gate.wait(100 * MS)
    gate.say(gate.now)
    gate.steady += 100 * MS
    assert gate.say(gate.now - 10 * MS) is StampOrder.LATE


def test_without_a_clock_two_stamps_in_a_row_begin_anew() -> None:
    gate = Gate(timed=False, ahead=math.inf, behind=math.inf)
    for k in range(3):
        assert gate.say(100 * SECOND + k * MS) is StampOrder.NEW
    assert gate.say(SECOND) is None  # one alone
    assert gate.say(100 * SECOND + 3 * MS) is StampOrder.NEW
    assert gate.say(SECOND) is None
    assert gate.say(SECOND + 5 * MS) is StampOrder.RESTART
    assert gate.validator.dropped == {Reason.BACKWARDS: 2}


def test_one_publisher_is_heard_until_it_is_silent() -> None:
    gate = Gate()
    assert gate.say(gate.now, "first") is StampOrder.NEW
    gate.wait(300 * MS)
    assert gate.say(gate.now, "second") is None
    assert gate.say(gate.now, "first") is StampOrder.NEW
    gate.wait(600 * MS)
    assert gate.say(gate.now, "second") is StampOrder.NEW
    assert gate.say(gate.now + MS, "first") is None
    assert gate.validator.dropped == {Reason.OTHER: 2}


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (JointState(name=[f"n{k}" for k in range(LARGEST)]), Reason.TOO_LARGE),
        (JointState(name=["a", "b"], position=[1.0]), Reason.MALFORMED),
        (JointState(name=["a"], effort=[1.0, 2.0]), Reason.MALFORMED),
        (JointState(name=["a", "a"], effort=[1.0, 2.0]), Reason.MALFORMED),
        (JointTrajectory(joint_names=["a"], points=[JointTrajectoryPoint(positions=[1.0] * 2)]), Reason.MALFORMED),
    ],
)
def test_a_message_that_does_not_fit_is_dropped(message: Any, reason: Reason) -> None:
    validator = MessageValidator(type(message), steady=lambda: 0)
    assert validator.unpack(serialize_message(message)) is None
    assert validator.dropped == {reason: 1}


def test_bytes_that_are_no_message_are_dropped() -> None:
    validator = MessageValidator(JointState, steady=lambda: 0)
    good = serialize_message(joint(SECOND, position=[1.0]))
    assert validator.unpack(good) == JointStates.of(joint(SECOND, position=[1.0]))
    for data in (b"", b"\x00", good[: len(good) // 2], b"\xff" * len(good)):
        assert validator.unpack(data) is None
    assert validator.dropped == {Reason.UNREADABLE: 4}


@pytest.mark.parametrize(
    ("value", "reason"),
    [(math.nan, Reason.NO_NUMBER), (math.inf, Reason.OUT_OF_RANGE), (-1e300, Reason.OUT_OF_RANGE)],
)
def test_numbers_that_no_rig_has_become_none(value: float, reason: Reason) -> None:
    validator, slots = (
        MessageValidator(JointState, steady=lambda: 0),
        Slots([SignalPlace("a", "position"), SignalPlace("b", "effort")]),
    )
    message = JointState(name=["b", "a"], position=[math.nan, value], effort=[2.0, math.nan])
    found = validator.read(JointStates.of(message), slots)
    assert found is not None
    assert math.isnan(found[0])
    assert found[1] == 2.0
    assert validator.dropped == {reason: 1}


def test_names_that_are_missing_are_counted() -> None:
    validator, slots = (
        MessageValidator(JointState, steady=lambda: 0),
        Slots([SignalPlace("a", "position"), SignalPlace("b", "effort")]),
    )
    assert validator.read(JointStates.of(joint(0, name=["a"], position=[1.0])), slots) == pytest.approx(
        [1.0, math.nan], nan_ok=True
    )
    assert validator.read(JointStates.of(joint(0, name=["c"], position=[1.0])), slots) is None
    assert validator.dropped == {Reason.UNNAMED: 1, Reason.UNRELATED: 1}


def test_a_stamp_is_near_up_to_its_bounds_and_no_further() -> None:
    gate = Gate()
    for stamp, near in ((20 * MS, True), (20 * MS + 1, False), (-500 * MS, True), (-500 * MS - 1, False)):
        assert gate.validator.is_near(gate.now + stamp) is near
        assert (Gate().say(gate.now + stamp) is StampOrder.NEW) is near
    assert Gate(timed=False).validator.is_near(0)


def test_without_a_clock_time_begins_anew_where_two_go_on_from_one_another() -> None:
    """Or are the same: a plant in lockstep that was reset repeats its first measurement until it is answered."""
    for second, order in (
        (0, StampOrder.RESTART),
        (1, StampOrder.RESTART),
        (SECOND - 1, StampOrder.RESTART),
        (SECOND, None),
        (-1, None),
    ):
        gate = Gate(timed=False)
        assert gate.say(10 * SECOND) is StampOrder.NEW
        assert gate.say(5 * SECOND) is None
        assert gate.say(5 * SECOND + second) is order
    gate = Gate(timed=False)
    assert gate.say(10 * SECOND) is StampOrder.NEW
    assert gate.say(SECOND // 2) is None  # there was none before that it could go on from
    assert gate.say(9 * SECOND) is StampOrder.LATE  # by no more than a restart
    assert gate.say(9 * SECOND - 1) is None


def test_without_a_clock_time_begins_anew_at_the_stamp_at_which_it_began() -> None:
    """A plant in lockstep that is put back says its first measurement once."""
    gate = Gate(timed=False)
    for stamp in (SECOND, 2 * SECOND):
        assert gate.say(stamp) is StampOrder.NEW
    assert gate.say(SECOND) is StampOrder.LATE  # no more than a second back
    assert gate.say(3 * SECOND) is StampOrder.NEW
    assert gate.say(SECOND) is StampOrder.RESTART
    gate.validator.forget()
    for stamp in (2 * SECOND, 4 * SECOND):
        assert gate.say(stamp) is StampOrder.NEW
    assert gate.say(SECOND) is None
    assert gate.say(2 * SECOND) is StampOrder.RESTART


def test_a_publisher_is_silent_from_its_bound_on() -> None:
    gate = Gate()
    assert gate.say(gate.now, "first") is StampOrder.NEW
    gate.wait(500 * MS - 1)
    assert gate.say(gate.now, "second") is None
    gate.wait(1)
    assert gate.say(gate.now, "second") is StampOrder.NEW
    assert gate.validator.source == "second"


def test_no_more_forms_are_known_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is unpacked by the middleware once, and all once more when there were too many."""
    validator = MessageValidator(JointState, steady=lambda: 0)
    unpacked: list[bytes] = []

    def unpack(data: bytes, kind: type[Any]) -> Any:
        unpacked.append(data)
        return deserialize_message(data, kind)

    monkeypatch.setattr("hybrid_sysid_ros.nodes.validation.deserialize_message", unpack)
    messages = [serialize_message(joint(5, name=["b" * (8 * k + 1)], position=[1.0])) for k in range(FORMS + 1)]
    for message in 2 * messages[:FORMS]:
        validator.unpack(message)
    assert len(unpacked) == FORMS
    for message in (messages[FORMS], *messages[:FORMS]):
        validator.unpack(message)
    assert len(unpacked) == 2 * FORMS + 1


def test_what_is_not_known_yet_is_told_from_what_is_wrong() -> None:
    validator, slots = (
        MessageValidator(JointState, steady=lambda: 0),
        Slots([SignalPlace("a", "position"), SignalPlace("b", "effort")]),
    )
    slots.low[:], slots.high[:] = [-1.0, -1.0], [1.0, 1.0]
    for value, inside in ((1.0, True), (-1.0, True), (1.001, False), (-1.001, False)):
        for other in (0.0, math.nan):  # what is wrong beside it changes nothing
            read = validator.read(JointStates("", 1, ["a", "b"], ([value, 0.0], [], [0.0, other])), slots)
            assert read is not None
            assert (read[0] == value) is inside
