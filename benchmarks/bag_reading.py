"""Reading of large bags into arrays, against rosbags' AnyReader: time, and memory, each in a process of its own.

The bags are sensor_msgs/JointState of one joint, position and effort at 1 kHz, as a driver records them; in the last
one every second message is a reference, and the project reads the file twice. All come out of the page cache. Readers
run in one thread and are compared by processor time, which other processes change little.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table
from rosbags.highlevel import AnyReader

from benchmarks import result
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.storage import Compression
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

NAME = "bag_reading"
NEEDED = 5.0  # times faster than AnyReader
STEP = 1_000_000  # ns between two messages of a topic
START = 1_700_000_000_000_000_000  # ns
PART = 50_000  # messages made at once
COMPRESSIONS: tuple[Compression, ...] = ("", "lz4", "zstd")
SLOWER = 0.1  # s, period of the record that stays small

Arrays = dict[str, NDArray[np.float64]]


def make(path: Path, messages: int, compression: Compression, topics: int) -> int:
    """Write a bag of so many messages and return its size in bytes."""
    noise = np.random.default_rng(0)
    with bags.BagWriter(path, compression=compression) as writer:
        for first in range(0, messages // topics, PART):
            k = np.arange(first, min(first + PART, messages // topics))
            at = START + STEP * k
            wanted = 0.5 * np.sin(1e-3 * k)[:, None]
            position, effort = (wanted + 1e-3 * noise.normal(size=wanted.shape) for _ in range(2))
            series = [bags.joint_states("/cam_beam/joint_states", at, ["beam"], position=position, effort=effort)]
            if topics == 2:
                reference = wanted[:, None, :]
                series.append(
                    bags.joint_trajectories("/cam_beam/reference", at, ["beam"], positions=reference, times=[0.0])
                )
            for stamp, *data in zip(at.tolist(), *(one.messages() for one in series), strict=True):
                for one, message in zip(series, data, strict=True):
                    writer.write_raw(one.topic, one.type, stamp, message)
    return sum(file.stat().st_size for file in path.iterdir())


def by_project(path: Path, period: float | None = None) -> Arrays:
    """A record's arrays."""
    record = bags.read(path, load_rig("cam_beam").signals, period=period)
    return {"time": record.time, "input": record.input[:, 0], "output": record.output[:, 0], **record.channels}


def by_anyreader(path: Path) -> Arrays:
    """The same arrays, from objects."""
    stamps, position, effort, reference = [], [], [], []
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/cam_beam/reference":
                reference.append(message.points[0].positions[0])
                continue
            stamps.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
            position.append(message.position[0])
            effort.append(message.effort[0])
    at = np.array(stamps, dtype=np.int64)
    found = {
        "time": (at - at[0]) * 1e-9,
        "input": np.array([*effort[1:], effort[-1]]),
        "output": np.array(position),
    }
    return {**found, "reference": np.array(reference)} if reference else found


READERS: dict[str, Callable[[Path], Arrays]] = {
    "project": by_project,
    "project, 10 Hz": lambda path: by_project(path, SLOWER),
    "AnyReader": by_anyreader,
}


def read(reader: str, path: Path, arrays: Path) -> None:
    """In a process of its own: read a bag, save the arrays, and print what it took."""
    before = _megabytes("VmRSS")
    begin, worked = perf_counter(), process_time()
    found = READERS[reader](path)
    seconds, worked = perf_counter() - begin, process_time() - worked
    peak = _megabytes("VmHWM")
    size = sum(array.nbytes for array in found.values()) / 1e6
    np.savez(arrays, **found)  # type: ignore[arg-type]
    taken = {"seconds": seconds, "processor_seconds": worked}
    print(json.dumps({**taken, "start_mb": before, "peak_mb": peak, "arrays_mb": size}))


def measure(reader: str, path: Path, arrays: Path, repeats: int = 1) -> dict[str, Any]:
    """Read a bag so many times, each in a new process; the times are medians."""
    command = [sys.executable, "-m", f"benchmarks.{NAME}", "--reader", reader, "--bag", str(path)]
    runs = []
    for _ in range(repeats):
        done = subprocess.run([*command, "--arrays", str(arrays)], check=True, stdout=subprocess.PIPE, text=True)
        runs.append(json.loads(done.stdout))
    seconds, worked = ([run[key] for run in runs] for key in ("seconds", "processor_seconds"))
    return {
        "reader": reader,
        "seconds": round(float(np.median(seconds)), 3),
        "processor_seconds": round(float(np.median(worked)), 3),
        "processor_seconds_range": [round(min(worked), 3), round(max(worked), 3)],
        "memory_mb": round(max(run["peak_mb"] - run["start_mb"] for run in runs), 1),
        "arrays_mb": round(runs[0]["arrays_mb"], 1),
    }


def check_equal(one: Path, other: Path) -> None:
    """Whether two readers made the same arrays: equal, but for the times to a nanosecond.

    Raises:
        UserError: they differ.
    """
    with np.load(one) as ours, np.load(other) as theirs:
        same = set(ours) == set(theirs) and all(np.array_equal(ours[key], theirs[key]) for key in set(ours) - {"time"})
        if not same or not np.allclose(ours["time"], theirs["time"], rtol=0.0, atol=1e-9):
            raise UserError(f"{NAME}: the arrays differ from AnyReader's")


def table(runs: list[dict[str, Any]]) -> Table:
    """A row for each bag and reader."""
    names = "messages, topics, chunks, file, reader, time, processor, messages/s, memory, arrays in it, faster"
    shown = Table(*names.split(", "), title="a bag to arrays")
    for run in runs:
        shown.add_row(
            f"{run['messages']:,}".replace(",", " "),
            str(run["topics"]),
            run["compression"] or "plain",
            f"{run['file_mb']:.0f} MB",
            run["reader"],
            f"{run['seconds']:.2f} s",
            f"{run['processor_seconds']:.2f} s",
            f"{1e-6 * run['messages'] / run['processor_seconds']:.2f} million",
            f"{run['memory_mb']:.0f} MB",
            f"{run['arrays_mb']:.0f} MB",
            f"{run['times_faster']:.1f}x" if "times_faster" in run else "",
        )
    return shown


def main() -> int:
    """Measure, print the table and write the results. 1 if the project is not fast enough."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000, help="in the bags that AnyReader reads too")
    parser.add_argument("--repeats", type=int, default=3, help="readings of a bag by the project; AnyReader reads once")
    parser.add_argument("--reader", choices=READERS, help=argparse.SUPPRESS)
    parser.add_argument("--bag", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--arrays", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.reader:
        read(options.reader, options.bag, options.arrays)
        return 0
    on = result.machine()
    messages = options.messages
    cases = [
        (size, compression, 1) for compression in COMPRESSIONS for size in (messages // 10, messages, 4 * messages)
    ]
    runs = []
    with TemporaryDirectory() as folder:
        for size, compression, topics in track([*cases, (messages, "zstd", 2)], description="reading", transient=True):
            with TemporaryDirectory(dir=folder) as place:
                bag, ours, theirs = (Path(place) / name for name in ("bag", "ours.npz", "theirs.npz"))
                file_mb = make(bag, size, compression, topics) / 1e6
                case = {"messages": size, "topics": topics, "compression": compression, "file_mb": round(file_mb, 1)}
                project = measure("project", bag, ours, options.repeats)
                found = [project]
                if size == messages:
                    found.append(measure("AnyReader", bag, theirs))
                    check_equal(ours, theirs)
                    project["times_faster"] = round(found[1]["processor_seconds"] / project["processor_seconds"], 1)
                found.append(measure("project, 10 Hz", bag, ours))
                runs += [{**case, **run} for run in found]
    print_table(table(runs))
    print(f"written to {result.write(NAME, {'runs': runs}, on=on)}")
    slowest = min(run["times_faster"] for run in runs if "times_faster" in run)
    if slowest < NEEDED:
        print(f"error: {slowest:g} times as fast as AnyReader, where {NEEDED:g} are needed", file=sys.stderr)
    return int(slowest < NEEDED)


def _megabytes(key: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024e-6
    raise UserError(f"{NAME}: /proc/self/status has no {key}: memory is measured on Linux only")


if __name__ == "__main__":
    result.run(main)
