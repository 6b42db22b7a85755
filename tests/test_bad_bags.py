"""A bad bag gets one clear line, and what is left of a cut one is read on request."""

import logging

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from test_bags import RATE, SIGNALS, references, stamps, states  # type: ignore[import-not-found]

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.mcap import MAGIC
from hybrid_sysid_ros.bags.signals import Signal, Signals
from hybrid_sysid_ros.support.errors import UserError


def changed(array, place, value):
    array = np.array(array)
    array[place] = value
    return array


def refused(path, reason, signals=SIGNALS):
    with pytest.raises(UserError, match=reason) as caught:
        bags.read(path, signals)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_what_is_no_bag_is_named(tmp_path):
    refused(tmp_path / "missing", "no such file or folder")
    refused(tmp_path, "is an empty folder")
    (tmp_path / "notes.txt").write_text("hello")
    refused(tmp_path, "is no bag")
    refused(tmp_path / "notes.txt", "is no ROS 2 bag")
    (tmp_path / "old.bag").write_text("#ROSBAG V2.0")
    refused(tmp_path / "old.bag", "rosbags-convert")
    (tmp_path / "empty.mcap").touch()
    refused(tmp_path / "empty.mcap", "is an empty file")
    (tmp_path / "text.mcap").write_text("this is text, whatever its name says")
    refused(tmp_path / "text.mcap", "is no MCAP file")
    (tmp_path / "stub.mcap").write_bytes(MAGIC)
    refused(tmp_path / "stub.mcap", "cut short")
    (tmp_path / "text.db3").write_text("this is text")
    refused(tmp_path / "text.db3", "text.db3: is damaged")


def test_a_folder_whose_files_are_gone_or_changed_is_named(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(100)])
    metadata = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text("{: no yaml")
    refused(bag, "is damaged")
    (bag / "metadata.yaml").write_text("")
    refused(bag, "is damaged")
    (bag / "metadata.yaml").unlink()
    assert bags.read(bag, SIGNALS).samples == 100  # the messages are all there
    (bag / "metadata.yaml").write_text(metadata)
    (bag / "run_0.mcap").unlink()
    refused(bag, "is no bag: a bag has an .mcap")


def test_a_bag_without_messages_is_named(tmp_path):
    with bags.BagWriter(tmp_path / "none"):
        pass
    refused(tmp_path / "none", "no topic /cam_beam/joint_states")
    refused(bags.write_bag(tmp_path / "run", [states(0)]), "no topic /cam_beam/joint_states")
    with Writer(tmp_path / "silent", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/cam_beam/joint_states", "sensor_msgs/msg/JointState", typestore=jazzy_types())
    refused(tmp_path / "silent", "has no messages")


def test_a_missing_topic_is_named_with_those_that_are_there(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [references()])
    reason = r"no topic /cam_beam/joint_states: the bag has /cam_beam/reference \(trajectory_msgs/msg/JointTrajectory\)"
    refused(bag, reason + r"; name the right one in .*rig\.yaml \(--signals\)")


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        ("position[arm]", "no joint 'arm', only beam, beam_filtered"),
        ("velocity[beam]", "the list has 0 entries"),
        ("position[2]", "the list has 2 entries, so no \\[2\\]"),
        ("angle", "there is no angle, only header, name, position, velocity, effort"),
        ("position", "no single number"),
        ("header.frame_id", "no single number"),
        ("header.stamp[0]", "no list"),
        ("header[beam]", "no list"),
    ],
)
@pytest.mark.parametrize("uniform", [True, False])
def test_a_missing_field_is_named(tmp_path, field, reason, uniform):
    topics = [states(100)]
    if not uniform:
        later = stamps(200)[100:]
        topics.append(
            bags.joint_states(
                "/cam_beam/joint_states", later, ["beam", "beam_filtered"], position=np.zeros((100, 2)), frame="x"
            )
        )
    bag = bags.write_bag(tmp_path / "run", topics)
    signal = Signal(topic="joint_states", field=field)
    signals = Signals(namespace="cam_beam", inputs={"u": signal}, outputs={"y": signal}, source="mine.yaml")
    refused(bag, rf"{reason}.*; name the right one in mine\.yaml \(--signals\)", signals)


def wrong_numbers(output=(), effort=()):
    position = changed(np.zeros((100, 2)), list(output), np.nan)
    return states(100, position=position, effort=changed(np.zeros((100, 2)), list(effort), np.nan))


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        (
            lambda: wrong_numbers(output=[40, 50]),
            r"position\[beam\] is nan at sample 40 \(0.2 s\), 2 such up to sample 99",
        ),
        (lambda: wrong_numbers(effort=[99]), r"effort\[beam\] is nan at sample 99"),
        (lambda: states(100, at=changed(stamps(100), 30, stamps(100)[29])), "repeated stamp at sample 30"),
        (lambda: states(100, at=changed(stamps(100), 30, stamps(100)[28] - 1)), "reversed stamp at sample 30"),
        (
            lambda: states(100, at=np.delete(stamps(160), slice(60, 120))),
            r"gap of 0.305 s after sample 59 .*60 samples",
        ),
        (lambda: states(100, at=np.delete(stamps(120), slice(60, 80))), r"20 of 120 samples are missing, in 1 gap"),
        (
            lambda: states(100, at=changed(stamps(100), 70, stamps(100)[70] + 2_000_000)),
            "sampling is not uniform: sample 70",
        ),
        (lambda: states(2), "only 2 samples"),
    ],
)
def test_wrong_numbers_and_stamps_are_named(tmp_path, topic, reason):
    refused(_as_recorded(tmp_path / "run", topic()), rf"topic /cam_beam/joint_states: {reason}")


def _as_recorded(path, topic):
    """A bag whose log times are in order, whatever the stamps in the headers."""
    with bags.BagWriter(path) as writer:
        for logged, data in zip(stamps(len(topic.stamps)).tolist(), topic.messages(), strict=True):
            writer.write_raw(topic.topic, topic.type, logged, data)
    return path


def test_a_little_jitter_is_put_on_the_grid(tmp_path):
    jitter = np.random.default_rng(4).integers(-900_000, 900_000, 1000)
    record = bags.read(bags.write_bag(tmp_path / "run", [states(at=stamps(1000) + jitter)]), SIGNALS)
    assert record.sampling_time == pytest.approx(1 / RATE, rel=1e-4)
    np.testing.assert_array_equal(record.output[:, 0], np.sin(0.01 * np.arange(1000)))


def test_an_unexpected_sampling_is_named(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(100)])
    signals = Signals(namespace="cam_beam", inputs=SIGNALS.inputs, outputs=SIGNALS.outputs, period=0.001)
    refused(bag, "sampling time is 0.005 s where 0.001 s is expected", signals)


def test_a_message_that_never_set_its_stamp_has_the_time_of_logging(tmp_path):
    unset = states(100, at=np.zeros(100, dtype=np.int64))
    record = bags.read(_as_recorded(tmp_path / "run", unset), SIGNALS)
    assert record.sampling_time == pytest.approx(1 / RATE, rel=1e-9)


# what is left of a bag that was cut


@pytest.mark.parametrize("compression", ["zstd", ""])
@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.9])
def test_a_cut_bag_is_recovered_up_to_the_cut(tmp_path, caplog, compression, fraction):
    bag = bags.write_bag(tmp_path / "run", [states(20_000)], compression=compression)
    file = bag / "run_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[: int(fraction * len(content))])
    refused(bag, "is cut short .*--recover")
    refused(file, "is cut short .*--recover")
    with caplog.at_level(logging.WARNING):
        record = bags.read(bag, SIGNALS, recover=True)
    assert (fraction - 0.25) * 20_000 < record.samples < (fraction + 0.2) * 20_000
    np.testing.assert_array_equal(record.output[:, 0], np.sin(0.01 * np.arange(record.samples)))
    assert f"recovered {record.samples} messages of {record.duration:.1f} s" in caplog.text


def test_a_bag_damaged_in_its_middle_is_recovered_up_to_the_damage(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(20_000)])
    file = bag / "run_0.mcap"
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 1000] = bytes(1000)
    file.write_bytes(content)
    refused(bag, "is damaged .*--recover")
    record = bags.read(bag, SIGNALS, recover=True)
    assert 1000 < record.samples < 15_000
    np.testing.assert_array_equal(record.output[:, 0], np.sin(0.01 * np.arange(record.samples)))


def test_a_cut_before_the_first_message_leaves_nothing(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(100)])
    (bag / "run_0.mcap").write_bytes((bag / "run_0.mcap").read_bytes()[:60])
    with pytest.raises(UserError, match="not one message can be recovered"):
        bags.read(bag, SIGNALS, recover=True)


def test_recovering_a_whole_bag_reads_it_all(tmp_path, caplog):
    bag = bags.write_bag(tmp_path / "run", [states(100)])
    assert bags.read(bag, SIGNALS, recover=True).samples == 100
    assert not caplog.records
