"""Base of all nodes of a rig: their parameters, topics, diagnostics and the folders that they have read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from time import monotonic_ns, sleep, time_ns
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile

from hybrid_sysid_ros.nodes import parameters, topics
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, STALE, WARN, Task, Troubles
from hybrid_sysid_ros.nodes.managed import ManagedNode
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.process import announce, peak_memory
from hybrid_sysid_ros.nodes.subscriptions import Listener
from hybrid_sysid_ros.nodes.validation import LARGEST, MessageValidator, Reason
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError

LOCKSTEP_DEPTH = 10_000  # messages that are kept for slower subscribers
REPORT_PERIOD = 0.4  # s, so that a change is reported within a second


class ModelSource:
    """A folder that a node has read. The node keeps the content that it read if the folder changes."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self._read = self._marks()

    def changed(self) -> str:
        """A sentence if the folder has changed since it was read, else "". It asks the disk, which may be slow."""
        now = self._marks()
        if now == self._read:
            return ""
        kept = "the one that was read stays in use until the node starts again"
        return f"{self.folder} {'has changed' if now else 'is gone'}: {kept}"

    def _marks(self) -> dict[str, tuple[int, int, int]]:
        """Inode, time of change and size of each file, by which a replaced file is recognised."""
        try:
            with os.scandir(self.folder) as entries:
                found = {entry.name: entry.stat() for entry in entries if entry.is_file()}
        except OSError:
            return {}
        return {name: (each.st_ino, each.st_mtime_ns, each.st_size) for name, each in found.items()}


class RigNode(ManagedNode):
    """A node of a rig. Its topics are relative names; with the parameter autostart it is active once it is made.

    settings: its parameters by name, checked.
    """

    NAME = ""
    """Default name of the node, and name of its section in msgs_config."""
    PUBLISHES: Sequence[str] = ()
    """Topics that the node publishes, besides /diagnostics."""
    SUBSCRIBES: Sequence[str] = ()

    def __init__(self, **options: Any) -> None:
        """options: of rclpy.node.Node (context, namespace, parameter_overrides).

        Raises UserError for a parameter that violates msgs_config, and the error that prevents autostart.
        """
        super().__init__(self.NAME, automatically_declare_parameters_from_overrides=True, **options)
        try:
            self._begin()
        except BaseException:
            self.destroy_node()  # the garbage collector would end it while other nodes communicate
            raise

    def _begin(self) -> None:
        self.settings = parameters.declare(self, self.NAME, self.accept, self.carried(), self.words_of)
        self.rig = rigs.load(self.settings["rig"])
        self.validators: dict[str, MessageValidator] = {}
        self.sources: Mapping[str, ModelSource] = {}
        """Folders that were read, by task."""
        self.changed: dict[str, str] = {}
        """A sentence about each folder that has changed since, by task."""
        self.incompatible_peers: Sequence[str] = ()
        """A line for each peer whose quality of service does not match, so that no message passes."""
        self.troubles: dict[str, Troubles] = {}
        self._ros_clock = self.get_clock()
        self._diagnostics = self.publication("/diagnostics")
        self._speaking = Lock()
        self.create_timer(REPORT_PERIOD, self.report, callback_group=self.service_group, clock=self._steady)
        if self.settings["autostart"]:
            self.bring_up()

    def cleanup(self) -> None:
        self.sources = {}

    def quality(self, topic: str) -> QoSProfile:
        """The QoS of a topic. Its queue is long in lockstep, for the recorder is slower than the loop."""
        return topics.profile(topic, depth=LOCKSTEP_DEPTH if self.settings.get("lockstep") else None)

    def carried(self) -> dict[str, set[str]]:
        """Full names of the node's topics, by entity."""
        names = {"publisher": (*self.PUBLISHES, "/diagnostics"), "subscription": self.SUBSCRIBES}
        return {entity: {self.resolve_topic_name(topic) for topic in found} for entity, found in names.items()}

    def prepare(self, settings: Mapping[str, Any], names: frozenset[str]) -> Callable[[], object]:
        """Prepare a change of parameters; return the action by which the loop applies it.

        settings: all new values; names: those that change. It is called while the node is configured, beside the loop.
        Raises UserError where the values are not possible.
        """
        return lambda: None

    def accept(self, given: Mapping[str, Any], fixed: Sequence[str]) -> None:
        """Accept changed values of parameters, all or none; fixed: those among them that configure() reads.

        Raises UserError where they are not possible.
        """
        if fixed and self.configured:
            raise UserError(
                f"parameter {fixed[0]} is read when the node is configured: deactivate and clean up the node before, "
                "or start it with another value"
            )
        settings = {**self.settings, **given}
        act = self.prepare(settings, frozenset(given)) if self.configured else lambda: None

        def take() -> None:
            self.settings.update(given)
            act()

        self.in_loop(take)

    @property
    def signature(self) -> str:
        """frame_id of the node's messages, which distinguishes publishers; "" in lockstep, so that runs repeat."""
        return "" if self.settings.get("lockstep") else f"{self.get_fully_qualified_name()} {os.getpid()}"

    def validator(self, topic: str) -> MessageValidator:
        """The validator of one of the rig's topics, within the limits of the node's parameters."""
        settings, timed = self.settings, not self.settings.get("lockstep")
        self.validators[topic] = validator = MessageValidator(
            topics.TYPES[topic],
            clock=self.now if timed else None,
            steady=monotonic_ns,
            ahead=settings["stamp_ahead"] * SECOND,
            behind=settings["stamp_behind"] * SECOND,
            silence=settings["silence"] * SECOND if timed else 0.0,
            largest=topics.LARGEST_OF.get(topic, LARGEST),
        )
        return validator

    def listen(self, validator: MessageValidator, topic: str, callback: Callable[[Any], None]) -> Listener:
        """Subscribe to one of the rig's topics; the callback receives the messages that its validator accepts."""

        def arrive(data: bytes) -> None:
            message = validator.unpack(data)
            if message is not None:
                callback(message)

        listener = self.subscribe(topics.TYPES[topic], topic, topics.profile(topic), arrive)
        if self.exchange is not None:
            listener.share(self.exchange)
        return listener

    def now(self) -> int:
        """Time of the ROS clock [ns]: simulated time, or the system's, which is read directly."""
        clock = self._ros_clock
        return int(clock.now().nanoseconds) if clock.ros_time_is_active else time_ns()

    def health(self) -> Sequence[Task]:
        """The status of each of the node's tasks. It is called in another thread than the loop's, so a dictionary that
        the loop changes must be copied before it is iterated over.
        """
        return [Task(name="loop")]

    def judged(self, name: str, counted: Mapping[str, int], total: int, **values: object) -> Task:
        """A task, judged by faults since the last report out of ``total`` tries; values are shown."""
        levels = {key: self.settings[f"{key}_share"] for key in ("warn", "error")}
        level, message = self.troubles.setdefault(name, Troubles()).judge(counted, total, **levels)
        return Task(name=name, level=level, message=message, values=values)

    def silent(self, task: Task, topic: str) -> Task:
        """The task, or a STALE one where a topic that had messages has been silent for stale_seconds."""
        validator = self.validators[topic]
        seconds = (monotonic_ns() - validator.heard) / SECOND
        if not validator.heard or seconds < self.settings["stale_seconds"]:
            return task
        return replace(task, level=STALE, message=f"nothing on {topic} for {seconds:.1f} s")

    def dropped(self, topic: str) -> dict[str, int]:
        """Messages that a topic's validator dropped, by reason, without those of other joints on the topic."""
        found = dict(self.validators[topic].dropped)
        return {reason.value: count for reason, count in found.items() if reason is not Reason.UNRELATED}

    def look_at_sources(self) -> None:
        """Check whether folders that were read have changed."""
        self.changed = {task: words for task, source in self.sources.items() if (words := source.changed())}

    def look_at_peers(self) -> None:
        """Find peers with incompatible quality of service; a new one is logged."""
        found = self.unmatched()
        for words in found:
            if words not in self.incompatible_peers:
                self.get_logger().warning(words)
        self.incompatible_peers = found

    def watch_sources(self) -> None:
        """Check the folders periodically, in a thread of its own, since a disk may not answer."""
        while not self.finished.done():
            self.look_at_sources()
            sleep(REPORT_PERIOD)

    def tasks(self) -> Sequence[Task]:
        """The status of each of the node's tasks, and of the folders that they have read."""
        if not self.active:
            return [self.idle()]
        found = {task.name: task for task in self.health()}
        first, notes = next(iter(found)), list(self.changed.items())
        for name in self.sources.keys() - found.keys():
            found[name] = Task(name=name)
        if self._ros_clock.ros_time_is_active and not self.now():
            notes.append((first, "use_sim_time is true, and nothing has come on /clock"))
        notes += [(first, words) for words in self.incompatible_peers]
        for name, words in notes:
            task = found[name]
            words = words if task.level == OK else f"{task.message}; {words}"
            found[name] = replace(task, level=max(task.level, WARN), message=words)
        return list(found.values())

    def idle(self) -> Task:
        """The status of a node that is not active."""
        if self.failure is None:
            return Task(name="loop", level=WARN, message=self.state)
        return Task(name="loop", level=ERROR, message=f"{self.state}: {self.failure}")

    def report(self) -> dict[str, object]:
        """Publish the diagnostics; return their values by key. It runs beside the loop, since it takes 1 ms."""
        with self._speaking:
            self.look_at_peers()
            tasks, node = self.tasks(), self.get_fully_qualified_name().strip("/")
            message = DiagnosticArray(status=[task.status(node, self.rig.name) for task in tasks])
            message.header.stamp = self.get_clock().now().to_msg()
            self._diagnostics.publish(message)
            return {key: value for task in tasks for key, value in task.values.items()}

    def close(self) -> None:
        """Print the diagnostics before the node is destroyed. Raises UserError where the node could not do its work."""
        try:
            if self.active:
                self.deactivate()
        finally:
            self.tell()

    def tell(self) -> None:
        """Print the diagnostics with the peak memory on the standard output."""
        values = {"node": self.NAME, **self.report(), "memory_mb": peak_memory()}
        announce(json.dumps({key: None if value != value else value for key, value in values.items()}))
