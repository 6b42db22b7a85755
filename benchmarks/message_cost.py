"""What a message costs a node, in one process: unpacked by the middleware and by its form, checked, packed.

The shortest of several repeats, as a processor does it that does nothing else; in a loop that sleeps in between, each
takes some times as long.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from time import monotonic_ns, perf_counter, time_ns
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rich.table import Table
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.nodes.cdr import JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.signal_layout import FIELDS, SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import MessageValidator

NAME = "message_cost"
SIZES = (1, 2, 20)  # joints, with position, velocity and effort each
POINTS = 101  # of a preview
REPEATS, CALLS = 400, 50
PARTS = {
    "deserialised": "unpacked by the middleware",
    "unpacked": "unpacked by its form",
    "read": "names and ranges checked",
    "admitted": "publisher and stamp checked",
    "serialised": "packed by the middleware",
    "packed": "packed by its form",
}


def seconds(call: Callable[[], object]) -> float:
    """Time that a call takes [s]."""
    shortest = math.inf
    for _ in range(REPEATS):
        began = perf_counter()
        for _ in range(CALLS):
            call()
        shortest = min(shortest, perf_counter() - began)
    return shortest / CALLS


def measure(joints: int) -> dict[str, float]:
    """Microseconds of each part, for a message of so many joints."""
    slots = Slots([SignalPlace(f"joint_{k}", field) for k in range(joints) for field in FIELDS])
    values, writer = [0.1 * k for k in range(len(slots))], JointWriter(slots, "/rig/estimator 12345")
    validator = MessageValidator(
        JointState, clock=time_ns, steady=monotonic_ns, ahead=60 * SECOND, behind=600 * SECOND, silence=SECOND / 2
    )
    data = writer.pack(time_ns(), values)
    said, message = validator.unpack(data), deserialize_message(data, JointState)
    assert said is not None
    calls: dict[str, Callable[[], Any]] = {
        "deserialised": lambda: deserialize_message(data, JointState),
        "unpacked": lambda: validator.unpack(data),
        "read": lambda: validator.read(said, slots),
        "admitted": lambda: validator.admit(said),
        "serialised": lambda: serialize_message(message),
        "packed": lambda: writer.pack(said.stamp, values),
    }
    return {name: 1e6 * seconds(call) for name, call in calls.items()}


def measure_preview(points: int) -> dict[str, float]:
    """Microseconds of each part, for a reference of one joint and so many points."""
    slots, offsets = Slots([SignalPlace("joint", "position")]), [k * SECOND // 1000 for k in range(points)]
    writer, rows = TrajectoryWriter(slots, offsets, "/rig/reference 12345"), [[0.1 * k] for k in range(points)]
    validator, tracked = MessageValidator(JointTrajectory, steady=monotonic_ns), np.array([True])
    data = writer.pack(time_ns(), rows)
    said, message = validator.unpack(data), deserialize_message(data, JointTrajectory)
    assert said is not None
    calls: dict[str, Callable[[], Any]] = {
        "deserialised": lambda: deserialize_message(data, JointTrajectory),
        "unpacked": lambda: validator.unpack(data),
        "read": lambda: Preview.of(said, validator, slots, tracked, 0),
        "serialised": lambda: serialize_message(message),
        "packed": lambda: writer.pack(said.stamp, rows),
    }
    return {name: 1e6 * seconds(call) for name, call in calls.items()}


def main() -> int:
    """Measure, print the table and write the results."""
    argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__).parse_args()
    on = result.machine()
    found = {f"joints_{joints}": measure(joints) for joints in SIZES} | {f"points_{POINTS}": measure_preview(POINTS)}
    shown = Table("", *found, title="us of a message")
    for part, title in PARTS.items():
        shown.add_row(title, *(f"{times[part]:.1f}" if part in times else "" for times in found.values()))
    print_table(shown)
    results = {name: {f"{part}_us": value for part, value in times.items()} for name, times in found.items()}
    print(f"written to {result.write(NAME, results, on=on)}")
    return 0


if __name__ == "__main__":
    result.run(main)
