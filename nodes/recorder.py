"""Recorder: writes topics into a bag, as `ros2 bag record` would, without rosbag2."""

from __future__ import annotations

import os
import sys
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from operator import attrgetter
from pathlib import Path
from threading import Event, Thread
from typing import Any, NamedTuple

from rclpy.qos import QoSProfile

from hybrid_sysid_ros.bags import QualityOfService, Recording, Split, collected
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Task
from hybrid_sysid_ros.nodes.parameter_query import ParameterQuery
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.runtime.run_provenance import folders, parameter_attachment
from hybrid_sysid_ros.support.errors import UserError

DEPTH = 10_000  # messages that wait for the recorder, which has a lower priority than the loop
NICENESS = 10  # niceness of the process
SEARCH_PERIOD = 0.5  # s
FLUSH_PERIOD = 0.25  # s, between two flushes to the disk
QUEUE_BYTES = 1 << 26  # bytes of messages that wait for the disk; more are lost
SLOW = 0.2  # s, for one block, above which the disk counts as slow
PATIENCE = 10.0  # s, to wait for the disk at the end
ASKED = ("plant", "reference", "estimator", "controller")  # nodes whose parameters the bag keeps


def next_free(path: Path | str) -> Path:
    """The first of PATH, PATH_2, PATH_3... that is not there."""
    names = (Path(f"{path}_{number}") if number > 1 else Path(path) for number in count(1))
    return next(name for name in names if not name.exists())


class Entry(NamedTuple):
    """A message that waits for the disk."""

    logged: int
    """Time of arrival [ns]."""
    published: int
    """Time of sending, from the middleware [ns]."""
    topic: str
    type: str
    data: bytes


class RecorderNode(RigNode):
    """Receives serialised messages with their times of arrival, and hands them to a thread that writes them.

    The middleware notes the time of arrival, since the recorder has a lower priority than the loop. The bag grows under
    its name, and all but the last second is on the disk. When the disk fails, messages wait in memory until it answers
    again, and messages beyond the memory are lost. At the end the bag is closed if possible, and the node ends with an
    error if something is missing in it.

    Messages of several topics come out of order, more so where this process has to wait. They lie in the bag in the
    order in which the middleware got them: now and then all that it has is taken, and what came before the last time
    can be written; all of it where half of the memory is taken. What the nodes of the loop have read, parameters and
    the folders that these name, is kept in the bag with them. Each time that the node is activated it begins a bag.
    """

    NAME = "recorder"
    SUBSCRIBES = topics.RECORDED
    resumed = False
    """Whether what the node recorded before must be kept."""

    def configure(self) -> None:
        if not self.settings["path"]:
            raise UserError("parameter path is empty: give the folder of the bag to write, as -p path:=FOLDER")

    def activate(self) -> None:
        path, wanted = self.settings["path"], self.settings["topics"].split()
        self.received: dict[str, int] = {}
        self.waiting: deque[Entry] = deque()
        self.held: list[Entry] = []
        """Messages in the order of their arrival; earlier ones may still come."""
        self.drained = self.settled = 0
        """Times at which all messages of the middleware were taken, the last and the one before [ns]: all messages
        before the latter are here.
        """
        self.qualities: dict[str, list[QualityOfService]] = {}
        """Quality of service of each topic's publishers at its first message."""
        self.attachments: deque[tuple[str, bytes]] = deque()
        """Attachments that are still to be written."""
        self.ended = Event()
        self.queued = self.unqueued = 0  # bytes; one thread counts each
        self.lost = 0  # messages for which the queue was full
        self.busy_since = 0.0  # s, when the write began that has not ended yet
        self.trouble: Exception | None = None
        self.searched: set[str] = set()
        known = {self.resolve_topic_name(topic): topic for topic in topics.TYPES}
        named = [*(wanted or topics.RECORDED), *self.settings["further"].split()]
        for name in map(self.resolve_topic_name, dict.fromkeys(named)):
            if name in known:
                topic = known[name]
                self.record(name, topics.TYPES[topic], topics.profile(topic, depth=DEPTH))
            else:
                self.searched.add(name)
        if self.searched:
            self.every(SEARCH_PERIOD, self.search)
        self.every(FLUSH_PERIOD, self.drain)
        self.query = ParameterQuery(self, ASKED, self.learn)
        split = Split(size=self.settings["split_bytes"], seconds=self.settings["split_seconds"])
        again = self.resumed or self.settings["resume"]
        replace = self.settings["overwrite"] and not again
        self.recording = Recording(next_free(path) if again else path, replace=replace, split=split)
        self.resumed = True
        self.writer = Thread(target=self.write, daemon=True)  # a disk that never answers keeps nobody
        self.writer.start()

    def record(self, name: str, message_type: Any, quality: QoSProfile) -> None:
        """Record a topic from now on."""
        self.received[name] = 0
        kind = f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"
        self.subscribe(message_type, name, quality, partial(self.keep, name, kind))

    def keep(self, name: str, kind: str, data: bytes, information: Mapping[str, int]) -> None:
        """Queue a message of a topic, if there is room."""
        self.received[name] += 1
        if name not in self.qualities:
            self.qualities[name] = topics.qualities_of(self.get_publishers_info_by_topic(name))
        if self.queued - self.unqueued + len(data) > QUEUE_BYTES:
            self.lost += 1
            return
        self.queued += len(data)
        logged = information["received_timestamp"] or time.time_ns()
        self.waiting.append(Entry(logged, information["source_timestamp"], name, kind, data))

    def drain(self) -> None:
        """Take all messages of the middleware."""
        started = time.time_ns()
        for listener in list(self._listeners):
            listener.drain()
        self.drained, self.settled = started, self.drained

    def learn(self, name: str, values: Mapping[str, Any]) -> None:
        """Attach a node's parameters and folders."""
        self.attachments.extend(parameter_attachment(name, values).items())
        try:
            self.attachments.extend(collected(folders(name, values)).items())
        except UserError as error:
            self.get_logger().warning(f"the bag lacks part of what the {name} has read: {error}")

    def search(self) -> None:
        """Subscribe to the topics that have a publisher, with its type and quality of service."""
        for name in sorted(self.searched):
            publishers = self.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            self.searched.discard(name)
            message_type = topics.type_of(publishers[0].topic_type)
            if message_type is None:
                self.get_logger().error(
                    f"topic {name} is not recorded: no type {publishers[0].topic_type} is installed"
                )
                continue
            offered = publishers[0].qos_profile
            quality = QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=offered.durability)
            self.record(name, message_type, quality)

    def write(self) -> None:
        """Write waiting messages until the end; runs in a thread of its own."""
        os.nice(NICENESS)  # for this thread, which began before the process had it
        try:
            with self.recording:
                while self.write_waiting(last=self.ended.wait(FLUSH_PERIOD)):
                    pass
        except (UserError, OSError) as error:
            self.trouble = error
            self.finish()

    def write_waiting(self, *, last: bool) -> bool:
        """Write waiting messages to the disk; return whether there will be more. Raises OSError where that fails."""
        self.busy_since = time.monotonic()
        try:
            if self.trouble is None or last:
                self.write_due(last=last)
            self.recording.flush()
            self.trouble = None
        except OSError as error:
            self.trouble = error
            if last or not self.recording.kept:
                raise
        self.busy_since = 0.0
        return not last

    def write_due(self, *, last: bool) -> None:
        """Write messages that no earlier one can precede any more. Write all at the end, and while half of the memory
        is used, since a wrong order is better than a loss.
        """
        settled, full = self.settled, 2 * (self.queued - self.unqueued) > QUEUE_BYTES
        for _ in range(len(self.waiting)):
            self.held.append(self.waiting.popleft())
        self.held.sort(key=attrgetter("logged"))
        due = len(self.held) if last or full else bisect_right(self.held, settled, key=attrgetter("logged"))
        written = 0
        try:
            for entry in self.held[:due]:
                self.recording.offer(entry.topic, entry.type, self.qualities[entry.topic])
                self.recording.write_raw(entry.topic, entry.type, entry.logged, entry.data, published=entry.published)
                written += 1
        finally:
            self.unqueued += sum(len(entry.data) for entry in self.held[:written])
            del self.held[:written]
        while self.attachments and self.recording.kept:
            self.recording.attach(*self.attachments.popleft(), time.time_ns())

    def deactivate(self) -> None:
        """Write the rest and end the bag. Raises UserError where it could not be written."""
        self.query.close()
        self.drain()
        self.ended.set()
        self.writer.join(PATIENCE)
        if self.writer.is_alive():
            self.trouble = TimeoutError(f"the disk does not answer for {PATIENCE:g} s")
        if self.trouble is not None:
            raise UserError(self.ending()) from self.trouble
        self.get_logger().info(f"{self.recording.path}: {self.recording.kept} messages")

    def failing(self) -> str:
        """The failure of the disk, in a line."""
        path, reason = self.recording.path, getattr(self.trouble, "strerror", None) or str(self.trouble)
        return reason if str(path) in reason else f"{path}: cannot be written ({reason})"

    def ending(self) -> str:
        """How a recording that failed ended, in a line."""
        bag, words = self.recording, self.failing()
        lost = sum(self.received.values()) - bag.kept
        words += f": {bag.kept} messages are kept, {lost} lost"
        return words if bag.old is None else f"{words}; the bag before is {bag.old}"

    def health(self) -> Sequence[Task]:
        received, path = sum(self.received.values()), self.recording.path
        lost = received - self.recording.kept if self.trouble is not None and self.ended.is_set() else self.lost
        values = {
            "messages": received,
            "kept": self.recording.kept,
            "lost": lost,
            "waiting": len(self.waiting) + len(self.held),
        }
        task = self.judged(
            "recorder", {f"messages lost, {path} is too slow": self.lost}, received, **values, **self.received
        )
        slow = time.monotonic() - self.busy_since if self.busy_since else 0.0
        if self.trouble is not None:
            return [replace(task, level=ERROR, message=self.ending() if self.ended.is_set() else self.failing())]
        if task.level == OK and slow > SLOW:
            return [replace(task, level=WARN, message=f"{path}: the disk does not answer for {slow:.1f} s")]
        if task.level == OK and self.searched:
            return [replace(task, level=WARN, message=f"no publisher of {', '.join(sorted(self.searched))}")]
        return [task]


def make() -> RecorderNode:
    """Make the node and lower its priority, but not that of the middleware's threads, which note the times."""
    node = RecorderNode()
    os.nice(NICENESS)
    return node


main = partial(run, make)

if __name__ == "__main__":
    sys.exit(main())
