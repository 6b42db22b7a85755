"""Base: what all nodes of a rig share: parameters, topics, diagnostics, and a clean end."""

from __future__ import annotations

import gc
import json
import math
import os
import resource
import signal
import socket
import sys
from collections.abc import Callable, Mapping
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from hybrid_sysid_ros.nodes import parameters, topics
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
REPORT_PERIOD = 1.0  # s
LOOK_PERIOD = 0.02  # s, between two looks whether a peer is there
PATIENCE = 2.0  # s, of an interrupt with a node that starts


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
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.open("/diagnostics")
        self._reporting = self.every(REPORT_PERIOD, self.report)

    def full_name(self, topic: str) -> str:
        """Name of a topic, for rclpy to resolve."""
        bare = self.get_namespace() == "/" and not topic.startswith("/")
        return f"{self.rig.namespace}/{topic}" if bare else topic

    def open(self, topic: str) -> Publisher:
        """Publisher of one of the rig's topics."""
        return self.create_publisher(topics.TYPES[topic], self.full_name(topic), topics.profile(topic))

    def listen(self, topic: str, callback: Callable[[Any], None], **options: Any) -> Subscription:
        """Subscription of one of the rig's topics; options: depth, raw."""
        quality = topics.profile(topic, depth=options.pop("depth", None))
        return self.create_subscription(topics.TYPES[topic], self.full_name(topic), callback, quality, **options)

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

    def now(self) -> int:
        """Time of the ROS clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def health(self) -> tuple[bytes, str, Mapping[str, object]]:
        """Level, summary and values for the diagnostics."""
        return OK, "running", {}

    def report(self) -> dict[str, object]:
        """Publish the diagnostics; return their values by key."""
        level, summary, found = self.health()
        values = dict(found)
        status = DiagnosticStatus(
            level=level,
            name=self.get_fully_qualified_name().strip("/"),
            message=summary,
            hardware_id=self.rig.name,
            values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        return values

    def prioritise(self) -> None:
        """Let all threads of this process go before those of others, if the node has a priority and may."""
        priority = self.settings.get("priority", 0)
        if not priority:
            return
        try:
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
        except (OSError, AttributeError) as error:  # not permitted, or no Linux
            self.get_logger().warning(f"no real-time priority ({error}): the limit for the user is `ulimit -r`")

    def finish(self) -> None:
        """End the node; may be called from any thread, and more than once."""
        if not self.finished.done():
            self.finished.set_result(None)

    def close(self) -> None:
        """Last words, before the node is destroyed: diagnostics, also on the standard output, with the peak memory."""
        values = {**self.report(), "memory_mb": _peak_memory()}
        announce(json.dumps({key: None if value != value else value for key, value in values.items()}))


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
    try:
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


def _serve(node: RigNode, ending: Interruption) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.prioritise()
    gc.collect()
    gc.freeze()  # what is there stays: collections in the loop look at nothing but what it makes
    ending.then(node.finish)
    announce("ready")
    try:
        executor.spin_until_future_complete(node.finished)
    finally:
        node.close()
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


def _text(value: object) -> str:
    if isinstance(value, float):
        return "nan" if math.isnan(value) else f"{value:.6g}"
    return str(value)
