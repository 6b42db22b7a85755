"""A recording outlives what ends it: what was put on the disk is read, under the name that was given."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from test_bags import SIGNALS, stamps, states  # type: ignore[import-not-found]

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import storage as room
from hybrid_sysid_ros.bags.mcap import McapFile
from hybrid_sysid_ros.support.errors import UserError

KIND = "sensor_msgs/msg/JointState"


def write(recording: bags.Recording, first: int, last: int, every: int = 100) -> None:
    """Write messages, the position of each being its number, and flush after so many."""
    numbers = np.arange(first, last)
    topic = states(last - first, at=stamps(last)[first:], position=np.column_stack([numbers, numbers]).astype(float))
    for k, (stamp, data) in enumerate(zip(topic.stamps.tolist(), topic.messages(), strict=True)):
        recording.write_raw(topic.topic, KIND, stamp, data)
        if (k + 1) % every == 0:
            recording.flush()


def recovered(path: Path) -> int:
    """Number of samples that a bag holds; they are the first of those written, all there and in order."""
    record = bags.read(path, SIGNALS, recover=True)
    np.testing.assert_array_equal(record.output[:, 0], np.arange(record.samples))
    return record.samples


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_recording_is_a_whole_bag(tmp_path: Path) -> None:
    with bags.Recording(tmp_path / "run") as recording:
        write(recording, 0, 250)
    assert (recording.kept, recording.whole, recording.old) == (250, True, None)
    assert bags.read(tmp_path / "run", SIGNALS).samples == 250
    assert bags.topics(tmp_path / "run")["/cam_beam/joint_states"].messages == 250
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == ["metadata.yaml", "run_0.mcap"]


def test_a_long_recording_keeps_little_of_its_index_in_memory(tmp_path: Path) -> None:
    chunks = 1500
    with bags.Recording(tmp_path / "run") as recording:
        write(recording, 0, 1)  # is flushed
        tracemalloc.start()
        write(recording, 1, chunks // 2, every=1)
        before = tracemalloc.get_traced_memory()[0]
        write(recording, chunks // 2, chunks, every=1)
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
    assert grown < 200 * chunks // 2
    with (tmp_path / "run" / "run_0.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()  # the library's own reading
    assert summary is not None
    assert summary.statistics is not None
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == chunks
    assert all(len(index.message_index_offsets) == 1 for index in summary.chunk_indexes)


def test_a_recording_without_a_message_is_an_empty_bag(tmp_path: Path) -> None:
    with bags.Recording(tmp_path / "run"):
        pass
    assert bags.topics(tmp_path / "run") == {}


def test_an_error_of_who_records_leaves_a_whole_bag(tmp_path: Path) -> None:
    with suppress(ZeroDivisionError), bags.Recording(tmp_path / "run") as recording:
        write(recording, 0, 150)
        _ = 1 / 0
    assert bags.read(tmp_path / "run", SIGNALS).samples == 150


# the process is killed

RECORDING = """
import sys
from pathlib import Path
from test_recording import *

with bags.Recording(Path(sys.argv[1]) / "run", replace=True) as recording:
    write(recording, 0, int(sys.argv[2]))
    print("written", flush=True)
    sys.stdin.read()
"""


def killed(folder: Path, messages: int) -> None:
    """A process that is killed after it wrote so many messages, flushing after each 100."""
    command = [sys.executable, "-c", RECORDING, str(folder), str(messages)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    with subprocess.Popen(command, stdin=-1, stdout=-1, env=environment, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "written\n"
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL


@pytest.mark.parametrize(("messages", "kept"), [(250, 200), (1, 1)])
def test_a_killed_recording_is_read_under_its_name(tmp_path: Path, messages: int, kept: int) -> None:
    """Its file has an end, for every reader; what it has not is metadata.yaml and an index."""
    killed(tmp_path, messages)
    assert names(tmp_path) == ["run"]
    assert names(tmp_path / "run") == [".reserve", "run_0.mcap"]
    assert bags.topics(tmp_path / "run")["/cam_beam/joint_states"].messages == kept
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == kept
    with pytest.raises(UserError, match="exists already"):
        bags.Recording(tmp_path / "run")
    with bags.Recording(tmp_path / "run", replace=True) as recording:  # what was cut may be replaced like a whole bag
        write(recording, 0, 50)
    assert bags.read(tmp_path / "run", SIGNALS).samples == 50
    assert names(tmp_path) == ["run"]


# the bag before


def test_the_bag_before_stays_until_the_first_message(tmp_path: Path) -> None:
    before = bags.write_bag(tmp_path / "run", [states(70)])
    killed(tmp_path, 0)
    assert bags.read(before, SIGNALS).samples == 70
    assert names(tmp_path) == ["run"]


def test_the_bag_before_is_kept_beside_a_recording_that_was_cut(tmp_path: Path) -> None:
    bags.write_bag(tmp_path / "run", [states(70)])
    killed(tmp_path, 100)
    killed(tmp_path, 200)
    assert recovered(tmp_path / "run") == 200
    assert recovered(tmp_path / "run.old2") == 100
    assert bags.read(tmp_path / "run.old", SIGNALS).samples == 70
    with bags.Recording(tmp_path / "run", replace=True) as recording:
        write(recording, 0, 50)
    assert bags.read(tmp_path / "run", SIGNALS).samples == 50
    assert names(tmp_path) == ["run", "run.old", "run.old2"]  # what nobody asked to replace


# the disk fails


def failing(monkeypatch: pytest.MonkeyPatch, folder: Path, capacity: int, error: int = errno.ENOSPC) -> None:
    """Let a disk take so many bytes below a folder and no more."""
    real = os.pwrite

    def attempt(descriptor: int, data: bytes, place: int) -> int:
        there = os.fstat(descriptor).st_size - place  # which may be overwritten
        room_left = there + capacity - sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
        if room_left <= 0:
            raise OSError(error, os.strerror(error))
        return real(descriptor, bytes(data)[:room_left], place)

    monkeypatch.setattr(room.os, "pwrite", attempt)


@pytest.mark.parametrize("every", [2, 1000])
def test_a_full_disk_leaves_a_whole_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: int) -> None:
    """The end fits in the room that the reserve leaves, also the long one of a bag with many chunks."""
    failing(monkeypatch, tmp_path, 500_000)
    recording = bags.Recording(tmp_path / "run")
    with pytest.raises(OSError, match="No space left"), recording:
        write(recording, 0, 1_000_000, every=every)
    assert recording.whole
    assert recording.kept > 1000
    assert bags.topics(tmp_path / "run")["/cam_beam/joint_states"].messages == recording.kept
    assert bags.read(tmp_path / "run", SIGNALS).samples == recovered(tmp_path / "run") == recording.kept
    assert names(tmp_path / "run") == ["metadata.yaml", "run_0.mcap"]


@pytest.mark.parametrize("error", [errno.EROFS, errno.EIO])
def test_a_disk_that_takes_nothing_more_leaves_what_it_has(tmp_path: Path, monkeypatch, error: int) -> None:
    before = bags.write_bag(tmp_path / "run", [states(70)])
    recording = bags.Recording(before, replace=True)
    write(recording, 0, 350)
    failing(monkeypatch, tmp_path, 0, error)
    with pytest.raises(OSError, match=os.strerror(error)), recording:
        write(recording, 350, 500)
    assert not recording.whole
    assert recovered(before) == recording.kept == 300
    assert recording.old is not None
    assert bags.read(recording.old, SIGNALS).samples == 70


def test_a_disk_that_is_full_from_the_start_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = bags.write_bag(tmp_path / "run", [states(70)])
    failing(monkeypatch, tmp_path, 0)
    with pytest.raises(UserError, match="cannot be written"), bags.Recording(before, replace=True) as recording:
        write(recording, 0, 100)
    assert bags.read(before, SIGNALS).samples == 70
    assert names(tmp_path) == ["run"]


def test_a_write_that_fails_may_be_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with bags.Recording(tmp_path / "run") as recording:
        write(recording, 0, 150)
        with monkeypatch.context() as patch:
            failing(patch, tmp_path, 0)
            with pytest.raises(OSError, match="No space left"):
                recording.flush()
        assert recording.kept == 100
        write(recording, 150, 400)
    assert bags.read(tmp_path / "run", SIGNALS).samples == recovered(tmp_path / "run") == 400


def test_what_is_flushed_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last file that was synchronised holds all messages: nothing that a power loss takes."""
    durable: list[int] = []
    real = os.fsync

    def synchronise(descriptor: int) -> None:
        real(descriptor)
        durable.append(os.fstat(descriptor).st_size)

    with bags.Recording(tmp_path / "run") as recording:
        write(recording, 0, 150)
        monkeypatch.setattr(room.os, "fsync", synchronise)
        recording.flush()
        (file,) = (tmp_path / "run").glob("*.mcap")
        assert durable == [file.stat().st_size]
        monkeypatch.undo()
        found = McapFile(file, None)
        assert sum(len(batch.data) for batches in found.batches() for batch in batches.values()) == 150


LIMITED = """
import resource, sys
from pathlib import Path
from test_recording import *

recording = bags.Recording(Path(sys.argv[1]) / "run")
with recording:
    write(recording, 0, 200)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
    try:
        write(recording, 200, 1_000_000)
    except OSError:
        print(recording.kept)
        raise
"""
FULL = """
import subprocess, sys
from pathlib import Path
from test_recording import *

disk, out = Path(sys.argv[1]) / "disk", Path(sys.argv[1]) / "out"
disk.mkdir()
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(disk)], check=True)
recording = bags.Recording(disk / "run")
try:
    with recording:
        write(recording, 0, 1_000_000)
except OSError:
    print(recording.kept)
shutil.copytree(disk / "run", out)
"""


def in_a_process(code: str, folder: Path, *before: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [*before, sys.executable, "-c", code, str(folder)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60.0)


def test_a_file_that_may_not_grow_is_kept(tmp_path: Path) -> None:
    """A limit of the operating system, at which the end has no room either."""
    end = in_a_process(LIMITED, tmp_path)
    assert "OSError: [Errno 27] File too large" in end.stderr
    assert recovered(tmp_path / "run") == int(end.stdout) > 1000


def test_a_disk_of_one_megabyte(tmp_path: Path) -> None:
    """A real one, in a name space of its own."""
    if subprocess.run(["unshare", "--map-root-user", "--mount", "true"], capture_output=True).returncode:
        pytest.skip("needs user name spaces")
    end = in_a_process(FULL, tmp_path, "unshare", "--map-root-user", "--mount")
    assert end.stderr == ""
    shutil.move(tmp_path / "out", tmp_path / "run")
    assert bags.read(tmp_path / "run", SIGNALS).samples == recovered(tmp_path / "run") == int(end.stdout) > 1000
