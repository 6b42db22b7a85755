"""Series: messages of one topic, serialised from arrays all at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.bags.layout import MessageLayout, field_of, jazzy_types
from hybrid_sysid_ros.bags.signals import parsed_field

SECOND = 1_000_000_000  # ns


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Messages of one topic: serialised (messages, bytes), and their times (messages,) [ns]."""

    topic: str
    type: str
    stamps: NDArray[np.int64]
    rows: NDArray[np.uint8]

    def messages(self) -> Iterator[bytes]:
        """Serialised messages, one after the other."""
        content, size = self.rows.tobytes(), self.rows.shape[1]
        return (content[start : start + size] for start in range(0, len(content), size))


def repeated(topic: str, template: Any, stamps: ArrayLike, columns: Mapping[str, ArrayLike]) -> Series:
    """Copy one message for each stamp and write arrays into its fields.

    template: a message of rosbags (jazzy_types().types[...]); all messages have the lengths of its lists.
    stamps: (messages,) [ns]; they also become header.stamp where there is a header.
    columns: arrays (messages,) by field, such as "effort[0]", "points[0].positions[arm]".
    """
    message_type = template.__msgtype__
    stamps = np.asarray(stamps, dtype=np.int64)
    raw = bytes(jazzy_types().serialize_cdr(template, message_type, little_endian=True))
    layout = MessageLayout.of(raw, message_type, jazzy_types().fielddefs)
    rows = np.tile(np.frombuffer(raw, dtype=np.uint8), (len(stamps), 1))
    values: dict[str, ArrayLike] = dict(columns)
    if "header" in layout.fields:
        values["header.stamp.sec"] = stamps // SECOND
        values["header.stamp.nanosec"] = stamps % SECOND
    for field, column in values.items():
        field_of(layout.fields, parsed_field(field)).write(rows, np.asarray(column))
    return Series(topic=topic, type=message_type, stamps=stamps, rows=rows)


def joint_states(
    topic: str,
    stamps: ArrayLike,
    names: Sequence[str],
    *,
    position: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    frame: str = "",
) -> Series:
    """sensor_msgs/JointState messages of joints `names`; each array is (messages, joints), or None."""
    given = {"position": position, "velocity": velocity, "effort": effort}
    arrays = {key: np.asarray(value, dtype=np.float64) for key, value in given.items() if value is not None}
    types = jazzy_types().types
    lists = {key: np.zeros(len(names) if key in arrays else 0) for key in given}
    template = types["sensor_msgs/msg/JointState"](header=_header(frame), name=list(names), **lists)
    columns = {f"{key}[{joint}]": array[:, joint] for key, array in arrays.items() for joint in range(len(names))}
    return repeated(topic, template, stamps, columns)


def joint_trajectories(
    topic: str,
    stamps: ArrayLike,
    names: Sequence[str],
    *,
    times: ArrayLike,
    positions: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    frame: str = "",
) -> Series:
    """trajectory_msgs/JointTrajectory messages of joints `names`.

    positions, velocities: (messages, points, joints), or None. times: (points,) [s], time_from_start of each point.
    """
    given = {"positions": positions, "velocities": velocities}
    arrays = {key: np.asarray(value, dtype=np.float64) for key, value in given.items() if value is not None}
    times = np.asarray(times, dtype=np.float64)
    types = jazzy_types().types
    nothing = np.zeros(0)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            **{key: np.zeros(len(names) if key in arrays else 0) for key in given},
            accelerations=nothing,
            effort=nothing,
            time_from_start=types["builtin_interfaces/msg/Duration"](
                sec=round(time * 1e9) // SECOND, nanosec=round(time * 1e9) % SECOND
            ),
        )
        for time in times.tolist()
    ]
    template = types["trajectory_msgs/msg/JointTrajectory"](
        header=_header(frame), joint_names=list(names), points=points
    )
    columns = {
        f"points[{point}].{key}[{joint}]": array[:, point, joint]
        for key, array in arrays.items()
        for point in range(len(times))
        for joint in range(len(names))
    }
    return repeated(topic, template, stamps, columns)


def _header(frame: str) -> Any:
    types = jazzy_types().types
    return types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=frame)
