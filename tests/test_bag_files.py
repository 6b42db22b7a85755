"""What bags are on the disk, as other readers see them: the mcap library's and rosbags'."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import McapReader, make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.interfaces import Qos, QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from test_bags import SIGNALS, START, references, stamps, states  # type: ignore[import-not-found]

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.support.errors import UserError

STATES, KIND = "/cam_beam/joint_states", "sensor_msgs/msg/JointState"
SECOND = 1_000_000_000


@contextmanager
def library(file: Path) -> Iterator[McapReader]:
    """The mcap library's reader of a file."""
    with file.open("rb") as stream:
        yield make_reader(stream, validate_crcs=True)


def in_the_file(file: Path) -> list[int]:
    """Log times of messages as they lie in a file."""
    found: list[int] = []
    with file.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
            if isinstance(record, Chunk):
                inside = [item for item in breakup_chunk(record, validate_crc=True) if isinstance(item, Message)]
                found += [message.log_time for message in inside]
    return found


def test_the_library_reads_the_same_messages(tmp_path: Path) -> None:
    series = [states(), references()]
    file = bags.write_bag(tmp_path / "run", series) / "run_0.mcap"
    with library(file) as reader:
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 2000
        for one in series:
            messages = list(reader.iter_messages([one.topic]))
            assert [message.data for _, _, message in messages] == list(one.messages())
            assert [message.log_time for _, _, message in messages] == one.stamps.tolist()
            assert {message.publish_time - message.log_time for _, _, message in messages} == {0}
    logged = in_the_file(file)
    assert logged == sorted(logged)
    assert len(logged) == 2000


def test_types_are_reported_as_ros_tells_them(tmp_path: Path) -> None:
    """Definition and hash against ROS's own, quality of service as rosbag2 writes it."""
    offered = bags.QualityOfService(reliability="best_effort", depth=5)
    with bags.BagWriter(tmp_path / "run") as writer:
        writer.offer(STATES, KIND, [offered])
        for stamp, data in zip(stamps(3).tolist(), states(3).messages(), strict=True):
            writer.write_raw(STATES, KIND, stamp, data)
    with library(tmp_path / "run" / "run_0.mcap") as reader:
        ((schema, channel, _), *_) = reader.iter_messages()
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (KIND, "ros2msg", "cdr")
    assert schema.data.decode().startswith("std_msgs/Header header\nstring[] name\nfloat64[] position\n")
    jazzy = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"  # `ros2 topic info -v`
    assert channel.metadata["topic_type_hash"] == jazzy
    (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert (profile["reliability"], profile["depth"], profile["history"]) == ("best_effort", 5, "keep_last")
    with bags.bag.opened(tmp_path / "run") as bag:
        assert bag.qualities[STATES] == [offered]
    with Reader(tmp_path / "run") as other:
        (connection,) = other.connections
        (quality,) = connection.ext.offered_qos_profiles  # type: ignore[union-attr]
        assert isinstance(quality, Qos)
        assert (quality.reliability, quality.durability) == (QosReliability.BEST_EFFORT, QosDurability.VOLATILE)
        assert connection.digest == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(KIND)


def test_the_time_of_sending_is_kept(tmp_path: Path) -> None:
    with bags.BagWriter(tmp_path / "run") as writer:
        for stamp, data in zip(stamps(10).tolist(), states(10).messages(), strict=True):
            writer.write_raw(STATES, KIND, stamp, data, published=stamp - 1234)
    with library(tmp_path / "run" / "run_0.mcap") as reader:
        assert [m.publish_time for _, _, m in reader.iter_messages()] == (stamps(10) - 1234).tolist()


@pytest.mark.parametrize("split", [bags.Split(seconds=1.0), bags.Split(size=30_000)], ids=["seconds", "size"])
@pytest.mark.parametrize("kind", [bags.BagWriter, bags.Recording])
def test_a_bag_goes_on_in_a_next_file(tmp_path: Path, split: bags.Split, kind: type[bags.BagWriter]) -> None:
    """Each file is readable alone, and all of them are one bag, for each reader."""
    noise = np.random.default_rng(0).normal(size=(1000, 2))  # which is not packed into nothing
    topic = states(1000, position=noise)
    with kind(tmp_path / "run", split=split) as writer:
        for k, (stamp, data) in enumerate(zip(topic.stamps.tolist(), topic.messages(), strict=True)):
            writer.write_raw(STATES, KIND, stamp, data)
            if isinstance(writer, bags.Recording) and k % 50 == 0:
                writer.flush()
    files = sorted((tmp_path / "run").glob("*.mcap"))
    assert [file.name for file in files] == [f"run_{k}.mcap" for k in range(len(files))]
    reported = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert reported["relative_file_paths"] == [file.name for file in files]
    assert reported["message_count"] == 1000
    if split.seconds:
        assert len(files) == 5
        assert [entry["message_count"] for entry in reported["files"]] == [200] * 5
        starts = [START + k * SECOND for k in range(5)]
        assert [entry["starting_time"]["nanoseconds_since_epoch"] for entry in reported["files"]] == starts
        assert {entry["duration"]["nanoseconds"] for entry in reported["files"]} == {SECOND - 5_000_000}
    elif kind is bags.Recording:
        assert len(files) > 1
    for file, entry in zip(files, reported["files"], strict=True):
        assert bags.topics(file)[STATES].messages == entry["message_count"]
        with library(file) as reader:
            assert len(list(reader.iter_messages())) == entry["message_count"]
    record = bags.read(tmp_path / "run", SIGNALS)
    np.testing.assert_array_equal(record.output[:, 0], noise[:, 0])
    with Reader(tmp_path / "run") as other:
        assert [data for _, _, data in other.messages()] == list(topic.messages())


def test_what_belongs_to_a_bag_is_kept_in_it(tmp_path: Path) -> None:
    place = tmp_path / "place"
    (place / "model" / "deep").mkdir(parents=True)
    (place / "model" / "model.yaml").write_text("a: 1\n")
    (place / "model" / "deep" / "weights").write_bytes(bytes(range(256)))
    (place / "note").write_text("by hand")
    found = bags.collected({"estimator/model": place / "model", "note": place / "note"})
    with bags.Recording(tmp_path / "run") as recording:
        for stamp, data in zip(stamps(10).tolist(), states(10).messages(), strict=True):
            recording.write_raw(STATES, KIND, stamp, data)
        for name, content in found.items():
            recording.attach(name, content, START)
        recording.flush()
        assert bags.attached(tmp_path / "run") == found  # also while it grows
    assert bags.attached(tmp_path / "run") == found
    with library(tmp_path / "run" / "run_0.mcap") as reader:
        assert {item.name: item.data for item in reader.iter_attachments()} == found
    folder = bags.laid_out(bags.attached(tmp_path / "run"), tmp_path / "out", below="estimator/model")
    assert (folder / "deep" / "weights").read_bytes() == bytes(range(256))
    assert (folder / "model.yaml").read_text() == "a: 1\n"
    with pytest.raises(UserError, match="has no controller/policy"):
        bags.laid_out(found, tmp_path / "out", below="controller/policy")
    with pytest.raises(UserError, match="leads out of its folder"):
        bags.laid_out({"model/../../escaped": b""}, tmp_path / "out", below="model")
    assert bags.attached(bags.write_bag(tmp_path / "bare", [states(10)])) == {}
    with pytest.raises(UserError, match="no such file"):
        bags.attached(tmp_path / "nowhere")


def test_messages_come_in_the_order_of_logging(tmp_path: Path) -> None:
    """One after the other over topics and files, also where those lie in the file one after the other."""
    with bags.BagWriter(tmp_path / "run", split=bags.Split(seconds=2.0)) as writer:
        for one in (states(300), references(300)):
            for stamp, data in zip(one.stamps.tolist(), one.messages(), strict=True):
                writer.write_raw(one.topic, one.type, stamp, data)
    with bags.bag.opened(tmp_path / "run") as bag:
        found = list(bag.messages(bag.topics))
        assert [logged for _, logged, _ in found] == sorted([*stamps(300).tolist(), *stamps(300).tolist()])
        alone = list(bag.messages([STATES]))
    assert [data for _, _, data in alone] == list(states(300).messages())
