"""Recorder: writes topics as they come into a bag, as `ros2 bag record` would, without rosbag2."""

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

DEPTH = 10_000  # messages that wait for the recorder: it comes after the loop
NICENESS = 10  # of the process
SEARCH_PERIOD = 0.5  # s
FLUSH_PERIOD = 0.25  # s, between two times that all is on the disk which came before the last two
QUEUE_BYTES = 1 << 26  # of messages that wait for the disk; what is over is lost
SLOW = 0.2  # s, that the disk takes for one block, from which on it is called slow
PATIENCE = 10.0  # s, with the disk at the end
ASKED = ("plant", "reference", "estimator", "controller")  # nodes whose parameters the bag keeps


def next_free(path: Path | str) -> Path:
    """The first of PATH, PATH_2, PATH_3... that is not there."""
    names = (Path(f"{path}_{number}") if number > 1 else Path(path) for number in count(1))
    return next(name for name in names if not name.exists())


class Entry(NamedTuple):
    """A message that waits for the disk."""

    logged: int
    """When it came [ns]."""
    published: int
    """When it was sent, as the middleware says [ns]."""
    topic: str
    type: str
    data: bytes


class RecorderNode(RigNode):
    """Takes serialised messages and the time they came, and hands them to a thread that writes.

    The middleware notes the time when a message comes; the recorder itself gives way to the loop. The bag grows under
    its name, and is on the disk but for the last second. When the disk fails later on, the loop is not left without
    its experiment: what comes waits in memory until the disk answers again, and what finds no room there is lost. At
    the end the bag is closed as well as may be, and the node ends with an error if something is missing in it.

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
        """In the order in which they came; others may still come before them."""
        self.drained = self.settled = 0
        """When all that the middleware had was taken for the last time, and the time before [ns]: nothing is missing
        that came before that.
        """
        self.qualities: dict[str, list[QualityOfService]] = {}
        """How each topic was offered when its first message came."""
        self.attachments: deque[tuple[str, bytes]] = deque()
        """What the bag is still to keep beside the messages."""
        self.ended = Event()
        self.queued = self.unqueued = 0  # bytes; each is counted by one thread
        self.lost = 0  # to a queue that is full
        self.busy_since = 0.0  # s, when the disk got what it has not answered yet
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
        """Put a message of a topic into the queue, if there is room."""
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
        """Take all that the middleware has."""
        started = time.time_ns()
        for listener in list(self._listeners):
            listener.drain()
        self.drained, self.settled = started, self.drained

    def learn(self, name: str, values: Mapping[str, Any]) -> None:
        """Keep what a node has read."""
        self.attachments.extend(parameter_attachment(name, values).items())
        try:
            self.attachments.extend(collected(folders(name, values)).items())
        except UserError as error:
            self.get_logger().warning(f"the bag does not keep all that the {name} has read: {error}")

    def search(self) -> None:
        """Take the topics that have a publisher by now, of whatever type, with the publisher's quality."""
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
        """Write what waits, again and again, until the end; runs in a thread of its own."""
        os.nice(NICENESS)  # of this thread, which was there before the process got it
        try:
            with self.recording:
                while self.write_waiting(last=self.ended.wait(FLUSH_PERIOD)):
                    pass
        except (UserError, OSError) as error:
            self.trouble = error
            self.finish()

    def write_waiting(self, *, last: bool) -> bool:
        """Put on the disk what waits; whether there will be more. Raises OSError where it can't begin, or not end."""
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
        """Write what nothing can come before any more; all at last, and while half of the memory is taken: out of order
        is better than lost.
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
        """What the disk does not do, in a line."""
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
    """Make the node, and let it give way: not the middleware's threads, which are there by then and note the times."""
    node = RecorderNode()
    os.nice(NICENESS)
    return node


main = partial(run, make)

if __name__ == "__main__":
    sys.exit(main())
