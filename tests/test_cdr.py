"""Joint messages and trajectories as bytes, against the middleware and against rosbags' own reading of CDR."""

from __future__ import annotations

import random
from array import array

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.cdr import JointForm, JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates, TrajectoryMessage, set_nanoseconds
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import FORMS, MessageValidator

TEXTS = ("", "a", "beam", "beam_ahead", "gelenk_ä", "関節", "🦾", "a b\t\n", "x" * 300)
STORE = get_typestore(Stores.ROS2_JAZZY)


def any_message(draw: random.Random) -> JointState:
    """Names of any length, once each, in any order; each list full or empty."""
    names = draw.sample(TEXTS, draw.randrange(len(TEXTS)))
    return any_numbers(draw, draw.choice(TEXTS), names, [len(names) * draw.randrange(2) for _ in range(3)])


def any_numbers(draw: random.Random, source: str, names: list[str], counts: list[int]) -> JointState:
    """A message of this form; its numbers are any of 64 bits, NaNs and infinities among them."""
    position, velocity, effort = (array("d", draw.randbytes(8 * count)) for count in counts)
    message = JointState(name=names, position=position, velocity=velocity, effort=effort)
    message.header.frame_id = source
    set_nanoseconds(message.header.stamp, draw.randrange(-(2**31), 2**31) * SECOND + draw.randrange(SECOND))
    return message


def rosbags_bytes(message: JointState, *, little: bool) -> bytes:
    header = message.header
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](header.stamp.sec, header.stamp.nanosec)
    said = types["sensor_msgs/msg/JointState"](
        types["std_msgs/msg/Header"](stamp, header.frame_id),
        message.name,
        *(np.array(values) for values in (message.position, message.velocity, message.effort)),
    )
    return bytes(STORE.serialize_cdr(said, "sensor_msgs/msg/JointState", little_endian=little))


def new_border() -> MessageValidator:
    return MessageValidator(JointState, steady=lambda: 0)


def shown(joints: JointStates | TrajectoryMessage | None) -> object:
    """For comparison, numbers bit by bit."""
    if joints is None:
        return None
    if isinstance(joints, TrajectoryMessage):
        rows = [[row.tobytes() for row in rows] for rows in joints.lists]
        return joints.source, joints.stamp, list(joints.names), joints.times.tolist(), rows
    return joints.source, joints.stamp, list(joints.names), [array("d", values).tobytes() for values in joints.lists]


def form_of(message: JointState) -> JointForm:
    joints = JointStates.of(message)
    return JointForm(joints.source, joints.names, [len(values) for values in joints.lists])


@pytest.mark.parametrize("seed", range(50))
def test_packed_messages_are_those_of_the_standard(seed: int) -> None:
    message = any_message(random.Random(seed))
    joints = JointStates.of(message)
    packed = form_of(message).pack(joints.stamp, joints.lists)
    assert packed == rosbags_bytes(message, little=True)
    assert shown(JointStates.of(deserialize_message(packed, JointState))) == shown(joints)


@pytest.mark.parametrize("seed", range(50))
def test_a_form_reads_what_the_middleware_reads(seed: int) -> None:
    draw = random.Random(seed)
    first = any_message(draw)
    source, counts = first.header.frame_id, [len(values) for values in JointStates.of(first).lists]
    form = form_of(first)
    for _ in range(5):
        message = any_numbers(draw, source, list(first.name), counts)
        assert shown(form.unpack(serialize_message(message))) == shown(JointStates.of(message))
        assert shown(form.unpack(rosbags_bytes(message, little=True))) == shown(JointStates.of(message))


@pytest.mark.parametrize("little", [True, False])
def test_both_orders_of_bytes_are_read(little: bool) -> None:
    validator, message = new_border(), any_numbers(random.Random(1), "beam", ["a", "関節"], [2, 0, 2])
    for _ in range(2):
        assert shown(validator.unpack(rosbags_bytes(message, little=little))) == shown(JointStates.of(message))


def test_a_border_knows_several_forms_and_forgets() -> None:
    validator, draw = new_border(), random.Random(2)
    messages = [any_message(draw) for _ in range(3 * FORMS)]
    for message in [*messages, *reversed(messages), *messages[:2] * 3]:
        assert shown(validator.unpack(serialize_message(message))) == shown(JointStates.of(message))


def damaged(draw: random.Random, good: bytes) -> bytes:
    """Bytes changed, cut, moved, added, exchanged for lengths that lead anywhere, or made up."""
    data = bytearray(good)
    place = draw.randrange(len(data))
    kind = draw.randrange(6)
    if kind == 0:
        data[place] ^= 1 << draw.randrange(8)
    elif kind == 1:
        del data[place:]
    elif kind == 2:
        data[place:place] = draw.randbytes(draw.randrange(1, 9))
    elif kind == 3:
        data += draw.randbytes(draw.randrange(1, 20))
    elif kind == 4:
        place -= place % 4
        data[place : place + 4] = draw.choice((0, 1, 2**16, 2**31, 2**32 - 1)).to_bytes(4, "little")
    else:
        data = bytearray(good[:4] + draw.randbytes(len(good)))
    return bytes(data)


@pytest.mark.parametrize("seed", range(20))
def test_damaged_messages_are_what_the_middleware_says_they_are(seed: int) -> None:
    draw = random.Random(seed)
    good = serialize_message(any_message(draw))
    for _ in range(100):
        validator, without_forms = new_border(), new_border()
        validator.unpack(good)
        data = damaged(draw, good)
        assert shown(validator.unpack(data)) == shown(without_forms.unpack(data))
        assert validator.dropped == without_forms.dropped


def test_what_is_written_can_be_read_by_name() -> None:
    slots = Slots([SignalPlace("a", "position"), SignalPlace("b", "effort"), SignalPlace("a", "effort")])
    writer, validator = JointWriter(slots, "someone"), new_border()
    for stamp in range(1, 4):
        values = [stamp, 2.0, -3.5]
        joints = validator.unpack(writer.pack(stamp, values))
        assert joints is not None
        assert (joints.source, joints.stamp) == ("someone", stamp)
        assert validator.read(joints, slots) == values


def any_trajectory(draw: random.Random, names: list[str], shape: tuple[int, ...], points: int) -> JointTrajectory:
    """Points with or without positions, velocities, accelerations and efforts, as the shape says, and any numbers."""
    message = JointTrajectory(joint_names=names)
    message.header.frame_id = "sender"
    set_nanoseconds(message.header.stamp, draw.randrange(2**31) * SECOND + draw.randrange(SECOND))
    for _ in range(points):
        position, velocity, acceleration, effort = (array("d", draw.randbytes(8 * len(names) * full)) for full in shape)
        point = JointTrajectoryPoint(positions=position, velocities=velocity, accelerations=acceleration, effort=effort)
        set_nanoseconds(point.time_from_start, draw.randrange(-(2**31), 2**31) * SECOND + draw.randrange(SECOND))
        message.points.append(point)
    return message


@pytest.mark.parametrize("seed", range(50))
def test_trajectories_are_read_as_the_middleware_reads_them(seed: int) -> None:
    draw = random.Random(seed)
    names, points = draw.sample(TEXTS, draw.randrange(4)), draw.randrange(5)
    shape = tuple(draw.randrange(2) for _ in range(4))
    validator = MessageValidator(JointTrajectory, steady=lambda: 0)
    for _ in range(3):
        message = any_trajectory(draw, names, shape, points)
        said, data = TrajectoryMessage.of(message), serialize_message(message)
        assert shown(validator.unpack(data)) == shown(said)
        for k, point in enumerate(message.points):
            for rows, values in zip(said.lists, (point.positions, point.velocities, point.effort), strict=True):
                assert array("d", [row[k] for row in rows]).tobytes() == values.tobytes()
        other = damaged(draw, data)
        assert shown(validator.unpack(other)) == shown(
            MessageValidator(JointTrajectory, steady=lambda: 0).unpack(other)
        )


def test_points_may_have_different_lists() -> None:
    points = [JointTrajectoryPoint(positions=[1.0]), JointTrajectoryPoint(velocities=[2.0])]
    validator = MessageValidator(JointTrajectory, steady=lambda: 0)
    for _ in range(2):
        said = validator.unpack(serialize_message(JointTrajectory(joint_names=["a"], points=points)))
        assert said is not None
        np.testing.assert_array_equal(said.lists[0], [[1.0, np.nan]])
        np.testing.assert_array_equal(said.lists[1], [[np.nan, 2.0]])
        assert not said.lists[2]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_written_trajectory_is_what_the_middleware_reads(count: int) -> None:
    slots = Slots([SignalPlace(f"joint {k}", field) for k in range(count) for field in ("position", "effort")])
    offsets = [0, 5_000_000, 2 * SECOND + 1]
    rows = np.random.default_rng(count).normal(size=(3, 2 * count))
    message = JointTrajectory(joint_names=slots.names)
    message.header.frame_id = "sender"
    set_nanoseconds(message.header.stamp, 7 * SECOND + 3)
    for row, offset in zip(rows, offsets, strict=True):
        point = JointTrajectoryPoint(positions=row[::2], effort=row[1::2])
        set_nanoseconds(point.time_from_start, offset)
        message.points.append(point)
    packed = TrajectoryWriter(slots, offsets, "sender").pack(7 * SECOND + 3, rows.tolist())
    assert deserialize_message(packed, JointTrajectory) == message
