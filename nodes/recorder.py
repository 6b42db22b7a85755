"""Recorder: writes topics as they come into a bag, as `ros2 bag record` would, without rosbag2."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from queue import SimpleQueue
from threading import Thread
from typing import Any

from rclpy.qos import QoSProfile

from hybrid_sysid_ros.bags import BagWriter
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.base import ERROR, OK, WARN, RigNode, run
from hybrid_sysid_ros.support.errors import UserError

DEPTH = 10_000  # messages that wait for the recorder: it comes after the loop
NICENESS = 10  # of the process
SEARCH_PERIOD = 0.5  # s
FLUSH_PERIOD = 1.0  # s, between two times that all is on the disk


class RecorderNode(RigNode):
    """Takes serialised messages and the time they came, and hands them to a thread that writes.

    The middleware notes the time when a message comes; the recorder itself gives way to the loop. The bag grows in a
    folder beside its place and takes it when the node ends.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("recorder", **options)
        path, wanted = self.settings["path"], self.settings["topics"].split()
        if not path:
            raise UserError("parameter path is empty: give the folder of the bag to write, as -p path:=FOLDER")
        self.received: dict[str, int] = {}
        self.queue: SimpleQueue[tuple[str, str, int, bytes] | None] = SimpleQueue()
        self.trouble: Exception | None = None
        self.searched: set[str] = set()
        known = {self.resolve_topic_name(self.full_name(topic)): topic for topic in topics.TYPES}
        for name in [self.resolve_topic_name(self.full_name(topic)) for topic in wanted] or list(known):
            if name in known:
                topic = known[name]
                self.take(name, topics.TYPES[topic], topics.profile(topic, depth=DEPTH))
            else:
                self.searched.add(name)
        if self.searched:
            self.every(SEARCH_PERIOD, self.search)
        self.stack = ExitStack()
        self.writer = self.stack.enter_context(BagWriter(path, replace=self.settings["overwrite"]))
        self.thread = Thread(target=self.write)
        self.thread.start()

    def take(self, name: str, message_type: Any, quality: QoSProfile) -> None:
        """Record a topic from now on."""
        self.received[name] = 0
        kind = f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"
        self.create_subscription(message_type, name, partial(self.keep, name, kind), quality, raw=True)

    def keep(self, name: str, kind: str, data: bytes, information: Mapping[str, int]) -> None:
        """Put a message of a topic into the queue."""
        self.queue.put((name, kind, information["received_timestamp"] or time.time_ns(), data))
        self.received[name] += 1

    def search(self) -> None:
        """Take the topics that have a publisher by now, of whatever type, with the publisher's quality."""
        for name in sorted(self.searched):
            publishers = self.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            self.searched.discard(name)
            package, _, kind = publishers[0].topic_type.rpartition("/")
            try:
                message_type = getattr(import_module(package.replace("/", ".")), kind)
            except (ImportError, AttributeError):
                self.get_logger().error(
                    f"topic {name} is not recorded: no type {publishers[0].topic_type} is installed"
                )
                continue
            offered = publishers[0].qos_profile
            quality = QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=offered.durability)
            self.take(name, message_type, quality)

    def write(self) -> None:
        """Write what is in the queue until None comes; runs in a thread of its own."""
        flushed = time.monotonic()
        try:
            while (entry := self.queue.get()) is not None:
                self.writer.write_raw(*entry)
                if time.monotonic() - flushed > FLUSH_PERIOD:
                    self.writer.flush()
                    flushed = time.monotonic()
        except (UserError, OSError) as error:
            self.trouble = error
            self.finish()

    def close(self) -> None:
        """Write the rest and put the bag in its place. Raises UserError where it cannot be written."""
        super().close()
        self.queue.put(None)
        self.thread.join()
        try:
            self.stack.close()
        except OSError as error:
            self.trouble = self.trouble or error
        if self.trouble is not None:
            raise UserError(f"{self.writer.path}: cannot be written ({self.trouble})") from self.trouble
        self.get_logger().info(f"{self.writer.path}: {self.writer.messages} messages")

    def health(self) -> tuple[bytes, str, Mapping[str, object]]:
        values = {"messages": sum(self.received.values()), "waiting": self.queue.qsize(), **self.received}
        if self.trouble is not None:
            return ERROR, str(self.trouble), values
        if self.searched:
            return WARN, f"no publisher of {', '.join(sorted(self.searched))}", values
        return OK, "recording", values


def make() -> RecorderNode:
    """Make the node, and let it give way: not the middleware's threads, which are there by then and note the times."""
    node = RecorderNode()
    os.nice(NICENESS)
    return node


main = partial(run, make)

if __name__ == "__main__":
    sys.exit(main())
