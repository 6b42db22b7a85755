"""Joint messages as bytes: what we pack and unpack against the middleware, and against rosbags' own reading of CDR."""

from __future__ import annotations

import random
from array import array

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from hybrid_sysid_ros.nodes.border import FORMS, Border
from hybrid_sysid_ros.nodes.cdr import Form, JointWriter
from hybrid_sysid_ros.nodes.layout import Place, Slots
from hybrid_sysid_ros.nodes.messages import SECOND, Joints, set_nanoseconds

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


def new_border() -> Border:
    return Border(JointState, steady=lambda: 0)


def shown(joints: Joints | None) -> object:
    """For comparison, numbers bit by bit."""
    if joints is None:
        return None
    return joints.source, joints.stamp, list(joints.names), [array("d", values).tobytes() for values in joints.lists]


def form_of(message: JointState) -> Form:
    joints = Joints.of(message)
    return Form(joints.source, joints.names, [len(values) for values in joints.lists])


@pytest.mark.parametrize("seed", range(50))
def test_packed_messages_are_those_of_the_standard(seed: int) -> None:
    message = any_message(random.Random(seed))
    joints = Joints.of(message)
    packed = form_of(message).pack(joints.stamp, joints.lists)
    assert packed == rosbags_bytes(message, little=True)
    assert shown(Joints.of(deserialize_message(packed, JointState))) == shown(joints)


@pytest.mark.parametrize("seed", range(50))
def test_a_form_reads_what_the_middleware_reads(seed: int) -> None:
    draw = random.Random(seed)
    first = any_message(draw)
    source, counts = first.header.frame_id, [len(values) for values in Joints.of(first).lists]
    form = form_of(first)
    for _ in range(5):
        message = any_numbers(draw, source, list(first.name), counts)
        assert shown(form.unpack(serialize_message(message))) == shown(Joints.of(message))
        assert shown(form.unpack(rosbags_bytes(message, little=True))) == shown(Joints.of(message))


@pytest.mark.parametrize("little", [True, False])
def test_both_orders_of_bytes_are_read(little: bool) -> None:
    border, message = new_border(), any_numbers(random.Random(1), "beam", ["a", "関節"], [2, 0, 2])
    for _ in range(2):
        assert shown(border.unpack(rosbags_bytes(message, little=little))) == shown(Joints.of(message))


def test_a_border_knows_several_forms_and_forgets() -> None:
    border, draw = new_border(), random.Random(2)
    messages = [any_message(draw) for _ in range(3 * FORMS)]
    for message in [*messages, *reversed(messages), *messages[:2] * 3]:
        assert shown(border.unpack(serialize_message(message))) == shown(Joints.of(message))


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
        border, without_forms = new_border(), new_border()
        border.unpack(good)
        data = damaged(draw, good)
        assert shown(border.unpack(data)) == shown(without_forms.unpack(data))
        assert border.dropped == without_forms.dropped


def test_what_is_written_can_be_read_by_name() -> None:
    slots = Slots([Place("a", "position"), Place("b", "effort"), Place("a", "effort")])
    writer, border = JointWriter(slots, "someone"), new_border()
    for stamp in range(1, 4):
        values = [stamp, 2.0, -3.5]
        joints = border.unpack(writer.pack(stamp, values))
        assert joints is not None
        assert (joints.source, joints.stamp) == ("someone", stamp)
        assert border.read(joints, slots) == values
