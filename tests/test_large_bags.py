"""A bag is read block by block: the blocks leave no trace in the record, nor the size of the bag in the memory."""

import re
import struct
import subprocess
import sys
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from test_bags import RATE, SIGNALS, START, other_topics, plain, references, stamps, states  # type: ignore[import-not-found]

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import bag as bag_module
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.mcap import MAGIC
from hybrid_sysid_ros.support.errors import UserError

STATUS = "/proc/self/status"


def in_chunks(path, topics, size=10):
    """A bag whose chunks hold `size` messages."""
    found = [
        (stamp, topic, data) for topic in topics for stamp, data in zip(topic.stamps, topic.messages(), strict=True)
    ]
    with bags.BagWriter(path) as writer:
        for number, (stamp, topic, data) in enumerate(sorted(found, key=lambda entry: entry[0])):
            if number and number % size == 0:
                writer.flush()
            writer.write_raw(topic.topic, topic.type, int(stamp), data)
    return path


def same(one, other):
    assert one.time[-1] == pytest.approx(other.time[-1], rel=1e-12)
    assert one.channels.keys() == other.channels.keys()
    np.testing.assert_array_equal(one.output, other.output)
    np.testing.assert_allclose(one.input, other.input, rtol=1e-12, atol=1e-12)
    for key, channel in one.channels.items():
        np.testing.assert_array_equal(channel, other.channels[key])


def by_anyreader(path, topic="/cam_beam/joint_states"):
    """Position and effort as rosbags reads them, (messages, 2)."""
    with AnyReader([path]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        found: list[Any] = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(chosen)]
    return np.array([[message.position[0], message.effort[0]] for message in found])


def agrees_with_anyreader(path):
    record, expected = bags.read(path, SIGNALS), by_anyreader(path)
    np.testing.assert_array_equal(record.output[:, 0], expected[:, 0])
    np.testing.assert_array_equal(record.input[:-1, 0], expected[1:, 1])
    return record


@pytest.fixture
def small_blocks(monkeypatch):
    """A block for each chunk."""
    monkeypatch.setattr(bag_module, "BLOCK", 1)


# blocks


@pytest.mark.parametrize("stamped", [True, False])
def test_blocks_leave_no_trace(tmp_path, monkeypatch, stamped):
    at = stamps(500) if stamped else np.zeros(500, dtype=np.int64)
    topic = bags.Series(**{**vars(states(500, at=at)), "stamps": stamps(500)})
    bag = in_chunks(tmp_path / "run", [topic, references(500)], size=17)
    whole = agrees_with_anyreader(bag)
    assert set(whole.channels) == {"filtered", "reference"}
    monkeypatch.setattr(bag_module, "BLOCK", 1)
    same(agrees_with_anyreader(bag), whole)


@pytest.mark.parametrize("holds", ["preceding", "following"])
@pytest.mark.parametrize("step", [700_000, 5_000_000, 23_000_000])
def test_blocks_leave_no_trace_in_a_held_input(tmp_path, monkeypatch, holds, step):
    values = np.random.default_rng(1).normal(size=2_000_000_000 // step)
    drive = plain("/lab/drive", START + 100_000_000 + step * np.arange(len(values)), values)
    jitter = np.random.default_rng(2).integers(-900_000, 900_000, 500)
    bag = in_chunks(tmp_path / "run", [plain("/lab/angle", stamps(500) + jitter, np.arange(500.0)), drive])
    whole = bags.read(bag, other_topics(holds))
    monkeypatch.setattr(bag_module, "BLOCK", 1)
    same(bags.read(bag, other_topics(holds)), whole)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("k", [100, 101])
def test_what_is_wrong_is_named_by_its_number_in_the_bag(tmp_path, k):
    """At the first message of a block, and inside of it."""
    position = np.zeros((200, 2))
    position[k] = np.nan
    broken = in_chunks(tmp_path / "nan", [states(200, position=position)])
    with pytest.raises(UserError, match=rf"position\[beam\] is nan at sample {k} \({k / RATE:g} s\)"):
        bags.read(broken, SIGNALS)
    gap = in_chunks(tmp_path / "gap", [states(140, at=np.delete(stamps(200), slice(k, k + 60)))])
    with pytest.raises(
        UserError, match=rf"gap of 0.305 s after sample {k - 1} \({(k - 1) / RATE:g} s\), about 60 samples"
    ):
        bags.read(gap, SIGNALS)
    at = stamps(200)
    at[k] = at[k - 1]
    with pytest.raises(UserError, match=rf"repeated stamp at sample {k} \({(k - 1) / RATE:g} s\)"):
        bags.read(in_chunks(tmp_path / "twice", [states(200, at=at)]), SIGNALS)
    drive = plain("/lab/drive", at, np.zeros(200))
    both = in_chunks(tmp_path / "drive", [plain("/lab/angle", stamps(200), np.zeros(200)), drive])
    with pytest.raises(UserError, match=rf"/lab/drive: repeated stamp at message {k}"):
        bags.read(both, other_topics())
    alone = [
        states(k),
        bags.joint_states("/cam_beam/joint_states", stamps(200)[k:], ["arm"], position=np.zeros((200 - k, 1))),
    ]
    with pytest.raises(UserError, match=rf"field position\[beam\] is missing in message {k}: there is no joint 'beam'"):
        bags.read(in_chunks(tmp_path / "joint", alone), SIGNALS)


@pytest.mark.usefixtures("small_blocks")
def test_a_channel_that_ends_early_is_left_out(tmp_path):
    one = states(100)
    rest = bags.joint_states(
        "/cam_beam/joint_states", stamps(200)[100:], ["beam"], position=np.zeros((100, 1)), effort=np.zeros((100, 1))
    )
    record = bags.read(in_chunks(tmp_path / "run", [one, rest]), SIGNALS)
    assert record.samples == 200
    assert not record.channels


# a longer period


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("samples", [1000, 1001, 1003])
def test_a_longer_period_takes_every_nth_output_and_the_mean_input(tmp_path, samples):
    bag = in_chunks(tmp_path / "run", [states(samples), references(samples)], size=37)
    every, slow = bags.read(bag, SIGNALS), bags.read(bag, SIGNALS, period=4 / RATE)
    assert slow.sampling_time == pytest.approx(4 / RATE, rel=1e-12)
    np.testing.assert_array_equal(slow.output, every.output[::4])
    np.testing.assert_array_equal(slow.channels["filtered"], every.channels["filtered"][::4])
    np.testing.assert_array_equal(slow.channels["reference"], every.channels["reference"][::4])
    means = [every.input[k : min(k + 4, samples - 1) or k + 1].mean() for k in range(0, samples - 1, 4)]
    np.testing.assert_allclose(slow.input[: len(means), 0], means, rtol=1e-13)
    assert slow.samples == -(-samples // 4)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("holds", ["preceding", "following"])
def test_a_longer_period_averages_an_input_of_another_topic(tmp_path, holds):
    values = np.random.default_rng(1).normal(size=1000)
    at = START + np.arange(1000) * 500_000 + (500_000 if holds == "preceding" else 0)
    angle, drive = plain("/lab/angle", stamps(100), np.arange(100.0)), plain("/lab/drive", at, values)
    bag = in_chunks(tmp_path / "run", [angle, drive], size=100)
    record = bags.read(bag, other_topics(holds), period=0.02)
    np.testing.assert_array_equal(record.output[:, 0], np.arange(0, 100, 4))
    means = values.reshape(25, 40).mean(axis=1)
    np.testing.assert_allclose(record.input[:, 0], means, rtol=1e-12, atol=1e-12)
    late = in_chunks(tmp_path / "late", [angle, plain("/lab/drive", at[90:], values[90:])], size=100)
    record = bags.read(late, other_topics(holds), period=0.02)
    assert record.output[0, 0] == 12  # of the interval before, the first quarter is not known
    np.testing.assert_allclose(record.input[:, 0], means[3:], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("period", "reason"),
    [
        (0.0125, "sampling time is 0.005 s, and period 0.0125 s no multiple of it: the nearest is 0.01 s"),
        (0.001, "the nearest is 0.005 s"),
        (0.5, "only 2 samples"),
        (0.0, "period is 0: it needs seconds above 0"),
        (np.nan, "period is nan"),
    ],
)
def test_a_period_that_makes_no_record_is_refused(tmp_path, period, reason):
    with pytest.raises(UserError, match=reason):
        bags.read(bags.write_bag(tmp_path / "run", [states(200)]), SIGNALS, period=period)


# kinds of bags


def record_of(code, content):
    return struct.pack("<BQ", code, len(content)) + content


def test_chunks_of_any_compression_and_messages_without_chunks_are_read(tmp_path):
    bag = bags.write_bag(tmp_path / "run", [states(20_000), references(20_000)], compression="")
    expected = agrees_with_anyreader(bag)
    content = (bag / "run_0.mcap").read_bytes()
    position, loose, packed = len(MAGIC), b"", b""
    while content[position] != 0x0F:
        code, size = struct.unpack_from("<BQ", content, position)
        record = content[position + 9 : position + 9 + size]
        position += 9 + size
        if code == 0x06:
            inside = record[32 + 8 :]
            compressed = lz4.frame.compress(inside)
            head = record[:28] + struct.pack("<I", 3) + b"lz4" + struct.pack("<Q", len(compressed))
            loose, packed = loose + inside, packed + record_of(code, head + compressed)
        elif code == 0x01:
            loose, packed = loose + record_of(code, record), packed + record_of(code, record)
    for name, data in (("loose", loose), ("lz4", packed)):
        end = record_of(0x0F, bytes(4)) + record_of(0x02, bytes(20))
        (tmp_path / f"{name}.mcap").write_bytes(MAGIC + data + end + MAGIC)
        same(agrees_with_anyreader(tmp_path / f"{name}.mcap"), expected)


def test_a_bag_of_several_files_is_read_in_their_order(tmp_path):
    whole, parts = states(3000), tmp_path / "parts"
    parts.mkdir()
    metadata: dict[str, Any] = {}
    for number in range(12):  # part_10 comes after part_9
        part = slice(250 * number, 250 * (number + 1))
        one = bags.Series(topic=whole.topic, type=whole.type, stamps=whole.stamps[part], rows=whole.rows[part])
        bag = bags.write_bag(tmp_path / f"part_{number}", [one])
        (bag / f"part_{number}_0.mcap").rename(parts / f"part_{number}.mcap")
        metadata = metadata or yaml.safe_load((bag / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    information["relative_file_paths"] = [f"part_{number}.mcap" for number in range(12)]
    information["topics_with_message_count"][0]["message_count"] = 3000
    (parts / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    (parts / "stray.mcap").write_bytes((parts / "part_3.mcap").read_bytes())
    assert agrees_with_anyreader(parts).samples == 3000


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_bags_compressed_around_their_storage_are_read(tmp_path, plugin, mode):
    topic = states(3000)
    writer = Writer(tmp_path / "run", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(topic.topic, topic.type, typestore=jazzy_types())
        for stamp, data in zip(topic.stamps.tolist(), topic.messages(), strict=True):
            writer.write(connection, stamp, data)
    assert agrees_with_anyreader(tmp_path / "run").samples == 3000


def test_messages_logged_out_of_order_are_put_in_order(tmp_path):
    topic = states(1000)
    data = list(topic.messages())
    order = np.random.default_rng(0).permutation(1000)
    with bags.BagWriter(tmp_path / "run") as writer:
        for k in order.tolist():
            writer.write_raw(topic.topic, topic.type, int(topic.stamps[k]), data[k])
    agrees_with_anyreader(tmp_path / "run")


# memory

GROWTH = """
import sys
from typing import Any
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.rigs.rig import load as load_rig

def kilobytes(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key))

signals = load_rig("cam_beam").signals
bags.read(sys.argv[1], signals)
before = kilobytes("VmRSS")
record = bags.read(sys.argv[2], signals, recover=sys.argv[3] == "recover")
print(record.samples, kilobytes("VmHWM") - before)
"""


@pytest.mark.slow
@pytest.mark.parametrize("what", ["wanted", "unwanted", "recover"])
def test_memory_does_not_grow_with_the_bag(tmp_path, what):
    """300 MB of messages with a thousand joints, or beside a topic of pictures."""
    try:
        with open(STATUS):
            pass
    except OSError:
        pytest.skip("needs /proc")
    names = ["beam", *(f"joint_{k}" for k in range(999 if what == "wanted" else 1))]
    zeros = np.zeros((100, len(names)))
    picture = jazzy_types().types["std_msgs/msg/String"](data="x" * 100_000)
    raw = bytes(jazzy_types().serialize_cdr(picture, picture.__msgtype__))
    with bags.BagWriter(tmp_path / "large", compression="") as writer:
        for start in range(0, 9000, 100):
            at = START + (start + np.arange(100)) * (1_000_000_000 // RATE)
            topic = bags.joint_states("/cam_beam/joint_states", at, names, position=zeros, effort=zeros)
            for k, (stamp, data) in enumerate(zip(at.tolist(), topic.messages(), strict=True)):
                writer.write_raw(topic.topic, topic.type, stamp, data)
                if what != "wanted" and k % 3 == 0:
                    writer.write_raw("/camera", picture.__msgtype__, stamp, raw)
    file = tmp_path / "large" / "large_0.mcap"
    size = file.stat().st_size
    assert size > 280e6
    if what == "recover":
        with file.open("r+b") as stream:
            stream.truncate(size - 100)
    small = bags.write_bag(tmp_path / "small", [states(100)])
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, str(small), str(file.parent), what], capture_output=True, text=True, check=True
    )
    samples, growth = (int(word) for word in re.findall(r"\d+", done.stdout))
    assert samples == 9000
    assert growth * 1024 < 60e6
    file.unlink()
