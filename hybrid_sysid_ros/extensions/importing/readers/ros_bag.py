"""Bags of ROS 1 and ROS 2 with any messages: each number of a message is a column, TOPIC.FIELD."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.bag import BLOCK, Messages, opened
from hybrid_sysid_ros.bags.columns import TopicColumns
from hybrid_sysid_ros.bags.layout import NAME_LISTS, MessageLayout, NumberPlace, Places, UnknownLayoutError
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile
from hybrid_sysid_ros.support.arrays import Array

WIDEST = 64
"""Most entries of a list that become columns."""
HEADER = "std_msgs/msg/Header"
STAMP = "stamp"
"""Column of a topic with its times: the headers' stamps, or the times of logging."""


class RosBagFile(LogFile):
    """A bag; the times of a topic are a column of their own, in seconds since the first one of the bag."""

    def __init__(self, path: Path) -> None:
        self._fields: dict[str, tuple[str, str]] = {}
        super().__init__(path, self._listed(path))

    def _listed(self, path: Path) -> Iterator[LogColumn]:
        for topic, count, message in self._firsts():
            try:
                layout = MessageLayout.of(message.data[0], message.type, message.types)
            except UnknownLayoutError:
                continue
            fields = [field for field in _numbers(layout.fields, "") if ".stamp." not in f".{field}"]
            if fields:
                yield LogColumn(name=f"{topic}.{STAMP}", samples=count, unit="s")
            for field in fields:
                self._fields[f"{topic}.{field}"] = topic, field
                yield LogColumn(name=f"{topic}.{field}", samples=count, time=f"{topic}.{STAMP}")

    def _firsts(self) -> Iterator[tuple[str, int, Messages]]:
        """Each topic with the number of its messages, and its first block."""
        with opened(self.path) as bag:
            seen = set[str]()
            for block in bag.blocks([name for name, topic in bag.topics.items() if topic.messages]):
                if block.topic not in seen:
                    seen.add(block.topic)
                    yield block.topic, bag.topics[block.topic].messages, block
                if len(seen) == sum(topic.messages > 0 for topic in bag.topics.values()):
                    return

    def _blocks(self, topics: Sequence[str]) -> Iterator[Messages]:
        with opened(self.path) as bag:
            yield from bag.blocks(topics)

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        wanted = dict[str, list[str]]()
        for name in names:
            topic = self._fields[name][0] if name in self._fields else name.removesuffix(f".{STAMP}")
            wanted.setdefault(topic, []).append(name)
        found = {name: list[Any]() for name in names}
        for block in self._blocks(list(wanted)):
            columns = TopicColumns(block)
            for name in wanted[block.topic]:
                if name in self._fields:
                    found[name].append(columns.values(self._fields[name][1]))
                else:
                    any_field = next(field for topic, field in self._fields.values() if topic == block.topic)
                    found[name].append(columns.stamps(any_field))
        stamps = [name for name in names if name not in self._fields]
        origin = min((int(found[name][0][0]) for name in stamps), default=0)
        return {
            name: np.concatenate(parts) if name in self._fields else (np.concatenate(parts) - origin) * 1e-9
            for name, parts in found.items()
        }


class Ros1BagFile(RosBagFile):
    """A bag of ROS 1, whose messages are turned into those of ROS 2."""

    def _firsts(self) -> Iterator[tuple[str, int, Messages]]:
        with _ros1(self.path) as reader:
            for connection in reader.connections:
                if connection.msgcount:
                    _, logged, raw = next(iter(reader.messages([connection])))
                    yield connection.topic, connection.msgcount, _converted(reader, connection, [logged], [raw], 0)

    def _blocks(self, topics: Sequence[str]) -> Iterator[Messages]:
        with _ros1(self.path) as reader:
            for topic in topics:
                for connection in (item for item in reader.connections if item.topic == topic):
                    logged, raws, first = list[int](), list[bytes](), 0
                    for _, stamp, raw in reader.messages([connection]):
                        logged.append(stamp)
                        raws.append(raw)
                        if len(raws) == BLOCK:
                            yield _converted(reader, connection, logged, raws, first)
                            logged, raws, first = [], [], first + BLOCK
                    if raws:
                        yield _converted(reader, connection, logged, raws, first)


@contextmanager
def _ros1(path: Path) -> Iterator[Any]:
    """An open bag, by whose types headers have no number, as those of ROS 2: the conversion leaves it out."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        types = reader.typestore.fielddefs
        if HEADER in types:
            constants, fields = types[HEADER]
            types[HEADER] = constants, [item for item in fields if item[0] != "seq"]
        yield reader


def _converted(reader: Any, connection: Any, logged: list[int], raws: list[bytes], first: int) -> Messages:
    """Messages of ROS 1 as ROS 2 has them."""
    kind, store = connection.msgtype, reader.typestore
    return Messages(
        topic=connection.topic,
        type=kind,
        types=store.fielddefs,
        logged=np.array(logged, dtype=np.int64),
        data=[bytes(store.ros1_to_cdr(raw, kind)) for raw in raws],
        first=first,
    )


def bag_file(path: Path) -> LogFile:
    """A bag of either ROS. Raises UserError as the readers do."""
    return Ros1BagFile(path) if path.suffix.lower() == ".bag" else RosBagFile(path)


def _numbers(node: Any, prefix: str) -> Iterator[str]:
    """Paths of the numbers in a layout; entries of joints go by their names."""
    if isinstance(node, NumberPlace):
        yield prefix
    elif isinstance(node, dict):
        names = next((list(node[key]) for key in NAME_LISTS if isinstance(node.get(key), list)), [])
        for key, item in node.items():
            if isinstance(item, Places) and len(item) == len(names) > 0:
                yield from (f"{prefix}{key}[{name}]" for name in names[:WIDEST])
            else:
                dot = "." if isinstance(item, dict) else ""
                yield from _numbers(item, f"{prefix}{key}{dot}")
    elif isinstance(node, Places):
        yield from (f"{prefix}[{k}]" for k in range(min(len(node), WIDEST)))
    elif isinstance(node, list):
        for k, item in enumerate(node[:WIDEST]):
            if isinstance(item, dict):
                yield from _numbers(item, f"{prefix}[{k}].")
