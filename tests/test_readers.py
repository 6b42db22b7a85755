"""Readers believe no file: what it says is compared with what it holds, and what it asks for is bounded."""

import logging
import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from test_bags import SIGNALS, references, states  # type: ignore[import-not-found]

from benchmarks.fuzz import crafted, records
from benchmarks.fuzz.worker import FAILURES, Reader
from hybrid_sysid_ros import bags, models
from hybrid_sysid_ros.bags.layout import jazzy_types
from hybrid_sysid_ros.bags.mcap import CHANNEL, CHUNK, LARGEST_CHUNK, MESSAGE, SCHEMA, STATISTICS
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.safety import certificate
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError

TOPIC = "/cam_beam/joint_states"
TRAINED = Path(__file__).parents[1] / "trained" / "cam_beam"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return bags.write_bag(tmp_path_factory.mktemp("bags") / "run", [states(40_000), references(40_000)])


@pytest.fixture
def bag(written, tmp_path):
    """A test's own, which it may change."""
    return shutil.copytree(written, tmp_path / "run")


def refused(path, *words, **options):
    with pytest.raises(UserError) as caught:
        bags.read(path, SIGNALS, **options)
    line = str(caught.value)
    assert line.isprintable()
    assert all(word in line for word in (str(path), *words))


def rewritten(bag, change, *, counted=True):
    """The bag's records as `change` makes them, in a file of its own beside it."""
    found = change(records.split((bag / "run_0.mcap").read_bytes()))
    path = bag.parent / "other.mcap"
    path.write_bytes(records.file_of(records.counted(found) if counted else found))
    return path


def inside(change):
    """Change the records in the first chunk, and keep no other."""

    def changed(found):
        chunk = next(content for code, content in found if code == CHUNK)
        return [found[0], (CHUNK, records.chunk_of("zstd", records.joined(change(records.inside(chunk)[1]))))]

    return changed


def highest():
    """Peak memory of this process [MB] since the last call."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("needs /proc")
    found = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    Path("/proc/self/clear_refs").write_text("5")
    return int(found.split()[1]) * 1024e-6


# what a bag says of itself


def test_messages_that_a_bag_says_it_has_and_has_not_are_counted(bag, caplog):
    found = records.split((bag / "run_0.mcap").read_bytes())
    last = [at for at, (code, _) in enumerate(found) if code == CHUNK][-1]
    lost = sum(code == MESSAGE for code, _ in records.inside(found[last][1])[1])
    found[last] = (0x80, found[last][1])  # a record that readers skip
    (bag / "run_0.mcap").write_bytes(records.file_of(found))
    chunks = sum(code == CHUNK for code, _ in found)
    refused(bag, f"{chunks} chunks", f"{chunks + 1}", "--recover")
    with caplog.at_level(logging.WARNING):
        assert 30_000 < bags.read(bag, SIGNALS, recover=True).samples < 40_000
    assert f"{80_000 - lost} messages" in caplog.text
    assert "80000" in caplog.text


def test_a_topic_under_another_name_is_noticed(bag):
    def renamed(found):
        return [
            (code, content.replace(b"joint_states", b"joint_statez") if code == CHANNEL else content)
            for code, content in found
        ]

    whole = records.split((bag / "run_0.mcap").read_bytes())
    changed = [
        (
            code,
            records.chunk_of("zstd", records.joined(renamed(records.inside(content)[1]))) if code == CHUNK else content,
        )
        for code, content in whole
    ]
    (bag / "run_0.mcap").write_bytes(records.file_of(changed))
    refused(bag, TOPIC, "40000", "0 messages")


def test_a_topic_that_the_summary_calls_otherwise_is_noticed(bag):
    found = records.split((bag / "run_0.mcap").read_bytes())
    at = max(at for at, (code, content) in enumerate(found) if code == CHANNEL and b"/cam_beam/reference" in content)
    found[at] = (CHANNEL, found[at][1].replace(b"/cam_beam/reference", b"/cam_beam/referencf"))
    (bag.parent / "other.mcap").write_bytes(records.file_of(found))
    refused(bag.parent / "other.mcap", "/cam_beam/reference")


def test_a_bag_without_statistics_or_repeated_channels_is_read_as_it_is(bag):
    found = records.split((bag / "run_0.mcap").read_bytes())
    for left_out in ((STATISTICS,), (SCHEMA, CHANNEL), (STATISTICS, SCHEMA, CHANNEL)):
        path = bag.parent / "other.mcap"
        path.write_bytes(records.file_of([record for record in found if record[0] not in left_out]))
        assert bags.read(path, SIGNALS).samples == 40_000


def test_metadata_and_file_must_agree(bag):
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    metadata.write_text(text.replace("message_count: 40000", "message_count: 39999"))
    refused(bag, "40000", "39999")
    metadata.write_text(text.replace("sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"))
    refused(bag, "sensor_msgs/msg/Imu")
    metadata.write_text(text)
    assert bags.read(bag, SIGNALS).samples == 40_000


def test_an_altered_definition_is_noticed(bag):
    file = bag / "run_0.mcap"
    found = records.split(file.read_bytes())
    at = next(at for at, (code, content) in enumerate(found) if code == SCHEMA and b"float64[] position" in content)
    content = found[at][1].replace(b"float64[] position\nfloat64[] velocity", b"float64[] velocity\nfloat64[] position")
    assert content != found[at][1]
    found[at] = (SCHEMA, content)
    file.write_bytes(records.file_of(found))
    refused(bag, TOPIC)


@pytest.mark.parametrize("compression", ["zstd", ""])
def test_no_changed_byte_of_our_own_bags_goes_unnoticed(tmp_path, compression):
    bag = bags.write_bag(tmp_path / "run", [states(300)], compression=compression)
    expected, file = bags.read(bag, SIGNALS), bag / "run_0.mcap"
    content = file.read_bytes()
    for place in range(0, len(content), 61):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        try:
            record = bags.read(bag, SIGNALS)
        except UserError:
            continue
        assert (record.output == expected.output).all()
        assert (record.input[1:] == expected.input[1:]).all()


# what a bag asks for


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("said", [1 << 30, 1000, LARGEST_CHUNK, (1 << 64) - 1])
@pytest.mark.parametrize("recover", [False, True])
def test_a_chunk_is_not_unpacked_beyond_what_it_says_or_may(bag, compression, said, recover):
    packed = crafted._zeros(compression, 1 << 30)
    bomb = (CHUNK, records.chunk_around(compression, packed, size=said))
    path = rewritten(bag, lambda found: [found[0], bomb, *found[1:]], counted=False)
    before = highest()
    refused(path, recover=recover)
    assert highest() < before + 2.5 * LARGEST_CHUNK / 1e6


@pytest.mark.parametrize("definition", range(len(crafted.DEFINITIONS)))
def test_a_definition_of_a_type_cannot_hang_a_reader(bag, definition):
    made = records.schema(1, "sensor_msgs/msg/JointState", crafted.DEFINITIONS[definition])
    change = inside(lambda found: [made if one[0] == SCHEMA and one[1][:2] == made[1][:2] else one for one in found])
    refused(rewritten(bag, change))


@pytest.mark.parametrize("definition", range(len(crafted.IDL)))
def test_a_definition_in_idl_cannot_hang_a_reader(bag, definition):
    made = records.schema(1, "sensor_msgs/msg/JointState", crafted.IDL[definition], "ros2idl")
    change = inside(lambda found: [made if one[0] == SCHEMA and one[1][:2] == made[1][:2] else one for one in found])
    refused(rewritten(bag, change))


def test_a_definition_in_idl_with_comments_and_annotations_is_read(bag):
    idl = (
        '// (a comment)\nmodule sensor_msgs { module msg { @verbatim (language="comment", text="(x)" "y")\n'
        "struct JointState { /* (no) header */ sequence<double> position; sequence<double> effort; }; }; };"
    )
    numbers = struct.pack("<4xI4x2dI4x2d", 2, 1.5, 2.5, 2, 3.5, 4.5)
    raw = b"\x00\x01\x00\x00" + numbers[4:]
    found = [records.schema(1, "sensor_msgs/msg/JointState", idl, "ros2idl"), records.channel(1, 1, TOPIC)]
    found += [records.message(1, 1_000_000_000 + k * 5_000_000, raw) for k in range(100)]
    path = rewritten(bag, lambda whole: [whole[0], (CHUNK, records.chunk_of("lz4", records.joined(found)))])
    content = {
        "inputs": {"u": {"topic": TOPIC, "field": "effort[1]"}},
        "outputs": {"y": {"topic": TOPIC, "field": "position[0]"}},
    }
    record = bags.read(path, Signals.of(content, "", "here"))
    assert record.output[5, 0] == 1.5
    assert record.input[5, 0] == 4.5


@pytest.mark.parametrize("filler", [1 << 22, 30 << 20])
def test_a_message_beyond_bounds_is_refused(bag, filler):
    def grown(found):
        large = next(content for code, content in found if code == MESSAGE)
        return [*found, *[(MESSAGE, large + bytes(filler))] * 2]

    refused(rewritten(bag, inside(grown)))


def test_a_file_packed_as_a_whole_is_bounded(tmp_path):
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        writer.add_connection(TOPIC, "sensor_msgs/msg/JointState", typestore=jazzy_types())
    (packed,) = (tmp_path / "run").glob("*.zstd")
    packed.write_bytes(crafted._zeros("zstd", 1 << 30))
    before = highest()
    refused(tmp_path / "run")
    assert highest() < before + 100


def test_messages_packed_one_by_one_are_unpacked_piece_by_piece(tmp_path):
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, "sensor_msgs/msg/JointState", typestore=jazzy_types())
        for stamp in range(2000):
            writer.write(connection, stamp, bytes(4_000_000))
    before = highest()
    refused(tmp_path / "run")
    assert highest() < before + 250


@pytest.mark.parametrize("statements", [one for one in crafted.SQL if "-9223372036854775808" not in one])
def test_a_spoiled_sqlite_bag_is_refused(tmp_path, statements):
    topic = states(300)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(topic.topic, topic.type, typestore=jazzy_types())
        for stamp, data in zip(topic.stamps.tolist(), topic.messages(), strict=True):
            writer.write(connection, stamp, data)
    with closing(sqlite3.connect(tmp_path / "run" / "run.db3")) as base:
        base.executescript(statements)
        base.commit()
    before = highest()
    refused(tmp_path / "run")
    assert highest() < before + 200


# models, policies, certificates


@pytest.mark.parametrize("kind", ["model", "policy"])
def test_a_model_s_rig_is_a_name_and_never_a_path_whose_python_would_run(tmp_path, kind):
    evil = tmp_path / "evil"
    evil.mkdir()
    (evil / "rig.yaml").write_text("step: 0.001")
    (evil / "system.py").write_text(f"import pathlib; pathlib.Path({str(tmp_path / 'ran')!r}).touch()")
    content, arrays = storage.load(TRAINED / kind, kind=kind, version={"model": 2, "policy": 3}[kind])
    kept = {key: item for key, item in content.items() if key not in ("seal", "format", "arrays")}
    storage.save(
        tmp_path / kind, kind=kind, version=content["format"], content={**kept, "rig": str(evil)}, arrays=arrays
    )
    with pytest.raises(UserError):
        models.load(tmp_path / kind) if kind == "model" else policies.load(tmp_path / kind)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("free", [[{"a": 1}], [["a"] * 3], 5])
def test_names_of_a_model_that_are_none_are_refused(tmp_path, free):
    content, arrays = storage.load(TRAINED / "model", kind="model", version=2)
    kept = {key: item for key, item in content.items() if key not in ("seal", "format", "arrays")}
    storage.save(tmp_path / "model", kind="model", version=2, content={**kept, "free": free}, arrays=arrays)
    with pytest.raises(UserError):
        models.load(tmp_path / "model")


@pytest.mark.parametrize(
    "change", [{"ledger": []}, {"delta": []}, {"bounds": {}}, {"ledger": [{"seed": 2}]}, {"worst": [{"loop": 1}]}]
)
def test_a_certificate_of_nonsense_is_refused(tmp_path, change):
    content = yaml.safe_load((TRAINED / "policy" / "certificate.yaml").read_text())
    seals = {key: content[key] for key in ("policy", "model")}
    kept = {key: item for key, item in content.items() if key not in ("seal", "format")}
    storage.save_sheet(tmp_path / certificate.FILE, version=content["format"], content={**kept, **change})
    with pytest.raises(UserError):
        certificate.find_certificate(tmp_path, **seals)
    storage.save_sheet(tmp_path / certificate.FILE, version=content["format"], content=kept)
    assert certificate.find_certificate(tmp_path, **seals) is not None


def test_some_mutations_of_all_files_are_refused_or_noticed(tmp_path):
    """A few of `python -m benchmarks fuzz`; memory is measured there, in processes of its own."""
    reader = Reader(0, tmp_path / "case")
    failed = [found for found in map(reader.run, range(200)) if found.outcome in FAILURES and found.outcome != "memory"]
    assert not failed
