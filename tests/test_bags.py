"""Bags in and out: what was written is read, in any message, as ROS writes it."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.signals import Signal, Signals
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

RATE = 200  # Hz
START = 1_700_000_000_000_000_000  # ns
SIGNALS = load_rig("cam_beam").signals


def stamps(samples):
    return START + np.arange(samples) * (1_000_000_000 // RATE)


def states(samples=1000, at=None, position=None, effort=None, names=("beam", "beam_filtered")):
    k = np.arange(samples)
    position = np.column_stack([np.sin(0.01 * k), np.cos(0.01 * k)]) if position is None else position
    effort = np.column_stack([0.1 * k, np.full(samples, np.nan)]) if effort is None else effort
    at = stamps(samples) if at is None else at
    return bags.joint_states("/cam_beam/joint_states", at, names, position=position, effort=effort)


def references(samples=1000, points=3):
    ahead = 0.001 * (np.arange(samples)[:, None] + 1 + np.arange(points))
    times = (1 + np.arange(points)) / RATE
    return bags.joint_trajectories(
        "/cam_beam/reference", stamps(samples), ["beam"], positions=ahead[:, :, None], times=times
    )


# what is written is read


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_a_bag_gives_back_what_was_written(tmp_path, compression):
    bag = bags.write_bag(tmp_path / "run", [states(), references()], compression=compression)
    for path, name in ((bag, "run"), (bag / "run_0.mcap", "run_0")):
        record = bags.read(path, SIGNALS)
        assert record.name == name
        assert record.sampling_time == pytest.approx(1 / RATE, rel=1e-12)
        np.testing.assert_array_equal(record.output[:, 0], np.sin(0.01 * np.arange(1000)))
        np.testing.assert_array_equal(record.channels["filtered"], np.cos(0.01 * np.arange(1000)))
    assert {topic.name: topic.messages for topic in bags.topics(bag).values()} == {
        "/cam_beam/joint_states": 1000,
        "/cam_beam/reference": 1000,
    }


def test_a_number_behind_a_dot_belongs_to_the_name_of_a_bag(tmp_path):
    for run in ("run.1", "run.2"):
        bag = bags.write_bag(tmp_path / run, [states()])
        for path, name in ((bag, run), (bag / f"{run}_0.mcap", f"{run}_0")):
            assert bags.read(path, SIGNALS).name == bags.name_of(path) == name


def test_the_effort_of_a_state_is_the_input_of_the_interval_before(tmp_path):
    effort = np.column_stack([0.1 * np.arange(1000), np.zeros(1000)])
    effort[0, 0] = np.nan  # what was applied before the first measurement is not known, and not needed
    record = bags.read(bags.write_bag(tmp_path / "run", [states(effort=effort)]), SIGNALS)
    np.testing.assert_array_equal(record.input[:-1, 0], effort[1:, 0])
    assert record.input[-1, 0] == effort[-1, 0]


def test_the_preview_of_a_reference_is_in_the_future(tmp_path):
    record = bags.read(bags.write_bag(tmp_path / "run", [states(), references()]), SIGNALS)
    assert np.isnan(record.channels["reference"][0])
    np.testing.assert_array_equal(record.channels["reference"][1:], 0.001 * np.arange(1, 1000))


def test_a_missing_channel_is_left_out(tmp_path):
    alone = states(names=["beam"], position=np.zeros((1000, 1)), effort=np.zeros((1000, 1)))
    assert not bags.read(bags.write_bag(tmp_path / "run", [alone]), SIGNALS).channels


def test_the_digest_is_of_the_content(tmp_path):
    first = bags.read(bags.write_bag(tmp_path / "a" / "run", [states()]), SIGNALS)
    again = bags.read(bags.write_bag(tmp_path / "b" / "run", [states()]), SIGNALS)
    other = bags.read(bags.write_bag(tmp_path / "c" / "run", [states(999)]), SIGNALS)
    assert first.digest == again.digest != other.digest


def test_messages_are_in_the_bag_in_the_order_of_their_stamps(tmp_path):
    from rosbags.rosbag2.storage_mcap import McapReader

    bag = bags.write_bag(tmp_path / "run", [states(), references()])
    reader = McapReader(bag / "run_0.mcap")
    reader.open()
    logged = [stamp for _, stamp, _ in reader.messages_scan(reader.connections)]  # as they lie in the file
    assert logged == sorted(logged)
    assert len(logged) == 2000
    reader.close()


@pytest.mark.parametrize("change", ["frame", "order", "endian"])
def test_messages_whose_layout_changes_are_read_one_by_one(tmp_path, change):
    """A frame_id of another length, joints in another order, big-endian bytes: the values are the same."""
    store, k = jazzy_types(), np.arange(50)
    with bags.BagWriter(tmp_path / "run") as writer:
        for number, stamp in enumerate(stamps(50).tolist()):
            odd = number % 2
            order = ["b", "beam"] if odd and change == "order" else ["beam", "b"]
            value = {"beam": float(number), "b": -1.0}
            values = np.array([value[name] for name in order])
            message = store.types["sensor_msgs/msg/JointState"](
                header=store.types["std_msgs/msg/Header"](
                    stamp=store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9),
                    frame_id="base" if odd and change == "frame" else "",
                ),
                name=order,
                position=values,
                velocity=np.zeros(0),
                effort=values,
            )
            little = not (odd and change == "endian")
            data = store.serialize_cdr(message, message.__msgtype__, little_endian=little)
            writer.write_raw("/cam_beam/joint_states", "sensor_msgs/JointState", stamp, data)
    record = bags.read(tmp_path / "run", SIGNALS)
    np.testing.assert_array_equal(record.output[:, 0], k)
    np.testing.assert_array_equal(record.input[:-1, 0], k[1:])


def test_a_foreign_bag_is_read_by_the_definitions_inside_it(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    definition = "std_msgs/Header header\nstring comment\nfloat32[3] volts\nint16 raw\n"
    store.register(get_types_from_msg(definition, "lab_msgs/msg/Sample"))
    types = store.types
    for plugin, name in ((StoragePlugin.MCAP, "mcap"), (StoragePlugin.SQLITE3, "sqlite")):
        with Writer(tmp_path / name, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/daq/sample", "lab_msgs/msg/Sample", typestore=store)
            for k, stamp in enumerate(stamps(100).tolist()):
                time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
                volts = np.array([0, 0.5 * k, 0], dtype=np.float32)
                sample = types["lab_msgs/msg/Sample"](header=header, comment="x" * (k % 3), volts=volts, raw=k - 50)
                writer.write(connection, stamp + 10**6 * (k % 5), store.serialize_cdr(sample, "lab_msgs/msg/Sample"))
        (tmp_path / "signals.yaml").write_text(
            "signals:\n"
            "  inputs: {raw: {topic: /daq/sample, field: raw, holds: following, scale: 2, offset: 1.0}}\n"
            "  outputs:\n"
            "    first: {topic: /daq/sample, field: 'volts[1]', unit: rad, scale: 0.1}\n"
            "    second: {topic: /daq/sample, field: 'volts[2]'}\n"
        )
        record = bags.read(tmp_path / name, Signals.load(tmp_path / "signals.yaml"))
        np.testing.assert_array_equal(record.input[:, 0], 2.0 * (np.arange(100) - 50) + 1)
        np.testing.assert_allclose(record.output, np.column_stack([0.05 * np.arange(100), np.zeros(100)]), rtol=1e-15)


def plain(topic, at, values):
    template = jazzy_types().types["std_msgs/msg/Float64"](data=0.0)
    return bags.repeated(topic, template, at, {"data": values})


def other_topics(holds="preceding"):
    return Signals(
        namespace="lab",
        inputs={"drive": Signal(topic="drive", field="data", holds=holds)},
        outputs={"angle": Signal(topic="angle", field="data")},
        channels={"drive": Signal(topic="drive", field="data")},
    )


@pytest.mark.parametrize("holds", ["preceding", "following"])
def test_an_input_of_another_rate_is_averaged_over_each_interval(tmp_path, holds):
    """Ten values of the drive a sample: input[k] is the mean of the ten in [k, k+1)."""
    fine = START + np.arange(1000) * 500_000
    values = np.random.default_rng(1).normal(size=1000)
    at = fine + (500_000 if holds == "preceding" else 0)
    angle = plain("/lab/angle", stamps(100), np.arange(100.0))
    bag = bags.write_bag(tmp_path / "run", [angle, plain("/lab/drive", at, values)])
    record = bags.read(bag, other_topics(holds))
    assert record.samples == 100
    np.testing.assert_allclose(record.input[:, 0], values.reshape(100, 10).mean(axis=1), rtol=1e-6, atol=1e-6)


def test_a_slow_input_is_held_and_unknown_ends_are_cut(tmp_path):
    at = stamps(100)[10:90:20] + 2_500_000  # half a sample late
    angle = plain("/lab/angle", stamps(100), np.arange(100.0))
    record = bags.read(
        bags.write_bag(tmp_path / "run", [angle, plain("/lab/drive", at, np.arange(4.0))]), other_topics("following")
    )
    assert record.output[0, 0] in (10, 11)  # the first command came between them
    assert record.output[-1, 0] in (90, 91)  # one interval of the commands after the last
    at_30 = int(30 - record.output[0, 0])
    np.testing.assert_allclose(record.input[at_30 - 1 : at_30 + 2, 0], [0.0, 0.5, 1.0], atol=1e-9)
    assert record.channels["drive"][at_30] == 0.0
    assert record.channels["drive"][at_30 + 1] == 1.0


def test_an_input_that_never_overlaps_is_named(tmp_path):
    angle = plain("/lab/angle", stamps(100), np.arange(100.0))
    late = plain("/lab/drive", stamps(100) + 10**10, np.arange(100.0))
    with pytest.raises(UserError, match="/lab/drive has no message while /lab/angle has"):
        bags.read(bags.write_bag(tmp_path / "run", [angle, late]), other_topics())


def test_commands_share_the_jitter_of_the_measurements_they_answer(tmp_path):
    at = stamps(100) + np.random.default_rng(2).integers(-900_000, 900_000, 100)
    values = np.random.default_rng(3).normal(size=100)
    angle, drive = plain("/lab/angle", at, np.arange(100.0)), plain("/lab/drive", at, values)
    record = bags.read(bags.write_bag(tmp_path / "run", [angle, drive]), other_topics("following"))
    np.testing.assert_allclose(record.input[:-1, 0], values[:-1], rtol=1e-9)


# the same bytes as ROS


def test_bytes_are_those_of_ros():
    serialization = pytest.importorskip("rclpy.serialization")
    from builtin_interfaces.msg import Duration
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    # names and frames of lengths that need no padding: what rclpy puts into padding is arbitrary
    state = JointState(name=["arm", "arm_counted"], position=[0.25, -0.5], effort=[0.1, 0.2])
    trajectory = JointTrajectory(joint_names=["arm"])
    trajectory.points = [JointTrajectoryPoint(positions=[0.1], time_from_start=Duration(sec=1, nanosec=500_000_000))]
    at = [1_700_000_000_005_000_000]
    for message, frame, ours in (
        (
            state,
            "rig",
            bags.joint_states("/s", at, state.name, position=[[0.25, -0.5]], effort=[[0.1, 0.2]], frame="rig"),
        ),
        (
            trajectory,
            "rig1234",
            bags.joint_trajectories("/t", at, ["arm"], positions=[[[0.1]]], times=[1.5], frame="rig1234"),
        ),
    ):
        message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id = (
            1_700_000_000,
            5_000_000,
            frame,
        )
        (data,) = ours.messages()
        assert data == serialization.serialize_message(message)[: len(data)]  # which appends spare bytes
        assert serialization.deserialize_message(data, type(message)) == message


@pytest.mark.parametrize("frames", [("", ""), ("", "rig")])
def test_messages_that_ros_serialised_are_read(tmp_path, frames):
    serialization = pytest.importorskip("rclpy.serialization")
    from sensor_msgs.msg import JointState

    with bags.BagWriter(tmp_path / "run") as writer:
        for number, stamp in enumerate(stamps(50).tolist()):
            state = JointState(name=["beam"], position=[float(number)], effort=[-float(number)])
            state.header.stamp.sec, state.header.stamp.nanosec = divmod(stamp, 10**9)
            state.header.frame_id = frames[number % 2]
            data = serialization.serialize_message(state)
            writer.write_raw("/cam_beam/joint_states", "sensor_msgs/msg/JointState", stamp, data)
    record = bags.read(tmp_path / "run", SIGNALS)
    np.testing.assert_array_equal(record.output[:, 0], np.arange(50))
    np.testing.assert_array_equal(record.input[:-1, 0], -np.arange(1, 50))


# writing


def test_a_bag_is_not_overwritten_unasked(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(100)])
    with pytest.raises(UserError, match="exists already"):
        bags.write_bag(tmp_path / "run", [states(50)])
    with pytest.raises(ZeroDivisionError), bags.BagWriter(tmp_path / "run", replace=True):
        _ = 1 / 0
    assert bags.read(bag, SIGNALS).samples == 100
    assert bags.read(bags.write_bag(bag, [states(50)], replace=True), SIGNALS).samples == 50


def test_a_type_that_ros_has_not_got_is_named(tmp_path):
    with bags.BagWriter(tmp_path / "run") as writer:
        with pytest.raises(UserError, match="lab_msgs/msg/Sample"):
            writer.write_raw("/daq", "lab_msgs/msg/Sample", 0, b"")
        writer.write_raw("/daq", "std_msgs/msg/Bool", 0, bytes(5))
        with pytest.raises(UserError, match="has type std_msgs/msg/Bool"):
            writer.write_raw("/daq", "std_msgs/msg/Float64", 0, bytes(12))
