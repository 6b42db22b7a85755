"""Base: what all nodes of a rig share: parameters, topics, diagnostics, and a clean end."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import resource
import signal
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from threading import Lock, Thread
from time import monotonic_ns, sleep, time_ns
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.timer import Timer

from hybrid_sysid_ros.nodes import middleware, parameters, topics
from hybrid_sysid_ros.nodes.border import Border, Reason
from hybrid_sysid_ros.nodes.diagnostics import OK, STALE, WARN, Task, Troubles
from hybrid_sysid_ros.nodes.listener import Listener
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError

REPORT_PERIOD = 0.5  # s
SERVICE_PERIOD = 2e-3  # s, at least between two answers to parameter services, however many are asked
SWITCH_INTERVAL = 2e-4  # s, that another thread may keep the loop from going on
LOOK_PERIOD = 0.02  # s, between two looks whether a peer is there
PATIENCE = 2.0  # s, of an interrupt with a node that starts
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4  # of mlockall, on Linux


class RigNode(Node):
    """A node of a rig. Its topics are relative to its namespace; where it was given none, to that of the rig.

    settings: its parameters by name, checked. finished: done when the node has nothing more to do.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """options: of rclpy.node.Node (context, namespace, parameter_overrides).

        Raises UserError when a parameter is not as msgs_config says.
        """
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self.settings = parameters.declare(self, name)
        self.rig = rigs.load(self.settings["rig"])
        self.finished = Future()
        self._ending = self.create_guard_condition(lambda: None)  # lets the loop see that it is finished
        self.borders: dict[str, Border] = {}
        self.sources: dict[str, Source] = {}
        """Folders that were read, by the task that they are for."""
        self.changed: dict[str, str] = {}
        """What has become of those that are not the same any more."""
        self.troubles: dict[str, Troubles] = {}
        self._ros_clock = self.get_clock()
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.open("/diagnostics")
        self._speaking = Lock()
        self.create_timer(REPORT_PERIOD, self.report, callback_group=self.aside, clock=self._steady)

    @cached_property
    def aside(self) -> MutuallyExclusiveCallbackGroup:
        """What goes on in another thread than the loop's: see :class:`Services`."""
        return MutuallyExclusiveCallbackGroup()

    def create_service(self, *arguments: Any, **options: Any) -> Any:
        return super().create_service(*arguments, **{"callback_group": self.aside, **options})

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """Its group is that of what the middleware tells of it, of readers that ask for another quality above all."""
        return super().create_publisher(*arguments, **{"callback_group": self.aside, **options})

    def full_name(self, topic: str) -> str:
        """Name of a topic, for rclpy to resolve."""
        bare = self.get_namespace() == "/" and not topic.startswith("/")
        return f"{self.rig.namespace}/{topic}" if bare else topic

    def open(self, topic: str) -> Publisher:
        """Publisher of one of the rig's topics."""
        return self.create_publisher(topics.TYPES[topic], self.full_name(topic), topics.profile(topic))

    @property
    def signature(self) -> str:
        """frame_id of what the node publishes, to tell two of a kind apart; none in lockstep, where runs repeat."""
        return "" if self.settings["lockstep"] else f"{self.get_fully_qualified_name()} {os.getpid()}"

    def border(self, topic: str) -> Border:
        """The border of one of the rig's topics: how far its stamps are believed is what the node's parameters say."""
        settings, timed = self.settings, not self.settings["lockstep"]
        self.borders[topic] = border = Border(
            topics.TYPES[topic],
            clock=self.now if timed else None,
            steady=monotonic_ns,
            ahead=settings["stamp_ahead"] * SECOND,
            behind=settings["stamp_behind"] * SECOND,
            silence=settings["silence"] * SECOND if timed else 0.0,
        )
        return border

    def listen(self, border: Border, topic: str, callback: Callable[[Any], None]) -> Listener:
        """Hear one of the rig's topics: the callback gets what its border lets in."""

        def arrive(data: bytes) -> None:
            message = border.unpack(data)
            if message is not None:
                callback(message)

        name, quality = self.full_name(topic), topics.profile(topic)
        return Listener(self, topics.TYPES[topic], name, quality, arrive, soon=self.soon)

    def every(self, period: float, callback: Callable[[], object]) -> Timer:
        """Timer on the steady clock; period [s]."""
        return self.create_timer(period, callback, clock=self._steady)

    def when(self, condition: Callable[[], bool], action: Callable[[], None]) -> None:
        """Do something once, as soon as a condition holds."""

        def look() -> None:
            if condition():
                timer.cancel()
                self.destroy_timer(timer)
                action()

        timer = self.every(LOOK_PERIOD, look)

    def soon(self, action: Callable[[], None]) -> None:
        """Do something once, outside of callbacks that it would not suit."""
        self.when(lambda: True, action)

    def now(self) -> int:
        """Time of the ROS clock [ns]: simulated, or the system's, which needs no detour."""
        clock = self._ros_clock
        return int(clock.now().nanoseconds) if clock.ros_time_is_active else time_ns()

    def health(self) -> Sequence[Task]:
        """What the node says of each of its tasks; in another thread than the loop's, so no dictionary that the loop
        adds to is gone through before it is copied.
        """
        return [Task(name="loop")]

    def judged(self, name: str, counted: Mapping[str, int], total: int, **values: object) -> Task:
        """A task by what went wrong since the last report, of so many tries in all; values are shown."""
        levels = {key: self.settings[f"{key}_share"] for key in ("warn", "error")}
        level, message = self.troubles.setdefault(name, Troubles()).judge(counted, total, **levels)
        return Task(name=name, level=level, message=message, values=values)

    def silent(self, task: Task, topic: str) -> Task:
        """The task, or that nothing has come on a topic for stale_seconds, where something came before."""
        border = self.borders[topic]
        seconds = (monotonic_ns() - border.heard) / SECOND
        if not border.heard or seconds < self.settings["stale_seconds"]:
            return task
        return replace(task, level=STALE, message=f"nothing on {topic} for {seconds:.1f} s")

    def dropped(self, topic: str) -> dict[str, int]:
        """What was dropped at a topic's border, by reason; who shares a topic with other joints is not troubled."""
        found = dict(self.borders[topic].dropped)
        return {reason.value: count for reason, count in found.items() if reason is not Reason.UNRELATED}

    def look_at_sources(self) -> None:
        """See whether what was read is still there."""
        self.changed = {task: words for task, source in self.sources.items() if (words := source.changed())}

    def watch_sources(self) -> None:
        """Look at them again and again; in a thread of its own, for a disk may not answer."""
        while not self.finished.done():
            self.look_at_sources()
            sleep(REPORT_PERIOD)

    def tasks(self) -> Sequence[Task]:
        """What the node says of each of its tasks, and of what they have read."""
        found, changed = {task.name: task for task in self.health()}, self.changed
        for name in self.sources.keys() - found.keys():
            found[name] = Task(name=name)
        if self._ros_clock.ros_time_is_active and not self.now():
            changed = {**changed, next(iter(found)): "use_sim_time is true, and nothing has come on /clock"}
        for name, words in changed.items():
            task = found[name]
            words = words if task.level == OK else f"{task.message}; {words}"
            found[name] = replace(task, level=max(task.level, WARN), message=words)
        return list(found.values())

    def report(self) -> dict[str, object]:
        """Publish the diagnostics; return their values by key. Beside the loop, which it would hold up by 1 ms."""
        with self._speaking:
            tasks, node = self.tasks(), self.get_fully_qualified_name().strip("/")
            message = DiagnosticArray(status=[task.status(node, self.rig.name) for task in tasks])
            message.header.stamp = self.get_clock().now().to_msg()
            self._diagnostics.publish(message)
            return {key: value for task in tasks for key, value in task.values.items()}

    def prioritise(self) -> None:
        """Let all threads of this process go before those of others and keep what they have touched in memory, if the
        node has a priority and may.
        """
        priority = self.settings.get("priority", 0)
        if not priority:
            return
        try:
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
        except (OSError, AttributeError) as error:  # not permitted, or no Linux
            self.get_logger().warning(f"no real-time priority ({error}): the limit for the user is `ulimit -r`")
        try:
            _keep_in_memory()
        except (OSError, AttributeError) as error:
            self.get_logger().warning(f"memory may be paged out ({error}): the limit for the user is `ulimit -l`")

    def finish(self) -> None:
        """End the node; may be called from any thread, and more than once."""
        if not self.finished.done():
            self.finished.set_result(None)
            self._ending.trigger()

    def close(self) -> None:
        """Last words, before the node is destroyed: diagnostics, also on the standard output, with the peak memory."""
        values = {**self.report(), "memory_mb": _peak_memory()}
        announce(json.dumps({key: None if value != value else value for key, value in values.items()}))


def _keep_in_memory() -> None:
    """Keep every page of this process in memory from when it is first touched on: code that runs twice a second would
    be read from the disk again, which the loop waits for, where the system takes pages back that rest. Raises OSError
    where that is not permitted.
    """
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _peak_memory() -> float:
    """Largest resident memory of this process so far [MB]. The kernel counts it in 1024 bytes."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            # Not ru_maxrss, which a process inherits from the one that started it.
            return next(float(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1.024e-3
    except (OSError, StopIteration):  # no Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1e-6 if sys.platform == "darwin" else 1.024e-3)


def announce(word: str) -> None:
    """Tell whoever started this process how far it is, in a line on its standard output."""
    print(word, flush=True)


def run(make: Callable[[], RigNode]) -> int:
    """Run a node until it is finished or SIGINT or SIGTERM comes, once or more often; return the exit status.

    0: ended as it should; 2: a parameter, file or argument is wrong, told in one line.
    """
    ending = Interruption()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.freeze()  # what was imported stays: no collection looks at it again
    if os.environ.get(interruption.TETHER):
        Thread(target=_end_with_starter, daemon=True).start()
    try:
        middleware.prepare()
        try:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # what rclpy raises for arguments and parameter files that make no sense
            raise UserError(" ".join(str(error).split())) from error
        _serve(make(), ending)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except KeyboardInterrupt:
        return 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        rclpy.try_shutdown()
    return 0


def _end_with_starter() -> None:
    """End when the standard input does: whoever started this process is gone, however that went."""
    while os.read(0, 1024):  # not through sys.stdin, whose lock a thread may hold when Python ends
        pass
    os.kill(os.getpid(), signal.SIGTERM)


class Loop(SingleThreadedExecutor):
    """All of a node but what goes on aside."""

    def __init__(self, node: RigNode) -> None:
        super().__init__()
        self._aside = node.aside
        self.add_node(node)

    def can_execute(self, entity: Any) -> bool:
        return entity.callback_group is not self._aside and super().can_execute(entity)


class Services(SingleThreadedExecutor):
    """A node's services, parameters above all, and its diagnostics, in a thread of their own: no storm of questions and
    no report holds the loop up.

    So are the events of its publishers, which would cost the loop more than its messages, at each of them.
    """

    def __init__(self, node: RigNode) -> None:
        super().__init__()
        self._node = node

    def get_nodes(self) -> list[Node]:
        return [self._node]  # not added: a node has one executor, the loop's

    def can_execute(self, entity: Any) -> bool:
        return entity.callback_group is self._node.aside and super().can_execute(entity)

    def serve(self) -> None:
        """Answer, one after the other, until the context or this executor ends."""
        try:
            while self.context.ok() and not self._node.finished.done():
                self.spin_once(timeout_sec=0.1)
                sleep(SERVICE_PERIOD)
        except (ExternalShutdownException, ShutdownException):
            return


def _serve(node: RigNode, ending: Interruption) -> None:
    executor, services = Loop(node), Services(node)
    server = Thread(target=services.serve, daemon=True)
    server.start()
    Thread(target=node.watch_sources, daemon=True).start()
    node.prioritise()
    gc.collect()
    gc.freeze()  # what is there stays: collections in the loop look at nothing but what it makes
    ending.then(node.finish)
    announce("ready")
    try:
        # Not spin_until_future_complete, by which the future keeps a function of every turn: 260 bytes each.
        while executor.context.ok() and not node.finished.done():
            executor.spin_once()
    finally:
        try:
            node.close()
        finally:  # a thread that is left behind would end the process by SIGABRT
            node.finish()
            server.join()
            services.shutdown()
            executor.shutdown()
            node.destroy_node()


class Interruption:
    """SIGINT and SIGTERM, however often they come: a call of an action, as soon as there is one.

    A start that takes long, as it does where code is compiled, ends by KeyboardInterrupt after PATIENCE; a short one is
    not cut, for a recorder has a bag and a thread to close.

    Python runs its handlers between two of its own instructions, which may be long after the signal for a thread that
    waits in the middleware. So the signals' numbers also come through a socket, to a thread that waits for them.
    """

    def __init__(self) -> None:
        self._noted = False
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)
        signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)
        interruption.repeat_unheard()

    def then(self, action: Callable[[], None]) -> None:
        """Call `action`, from another thread, at the first signal, or now if it came before; others do nothing."""

        def wait() -> None:
            self._ours.recv(1)
            action()

        self._noted = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        Thread(target=wait, daemon=True).start()

    def _note(self, number: int, frame: object) -> None:
        if not self._noted:
            self._noted = True
            signal.setitimer(signal.ITIMER_REAL, PATIENCE)
