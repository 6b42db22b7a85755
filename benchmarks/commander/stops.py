"""Stops: from a request to the first command towards rest, in a loop of processes in real time."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from rich.progress import track

from hybrid_sysid_ros.commands.terminal import status
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.runtime.set_points import outputs_of
from hybrid_sysid_ros.support.arrays import Array

WAYS = ("service", "topic", "parameter")
SWING = "swing between {low:.3g} and {high:.3g} {unit} at 0.5 Hz for 60 s"
PATIENCE = 180.0  # s, with anything: what simulates gives way on a busy machine


class Operator:
    """Speaks to a commander and watches the commands."""

    def __init__(self, rig: Rig, domain: int) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticStatus
        from rcl_interfaces.srv import SetParameters
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import String
        from std_srvs.srv import SetBool, Trigger

        from hybrid_sysid_ros.nodes.border import Border
        from hybrid_sysid_ros.nodes.topics import TYPES, profile

        self.context = rclpy.context.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("operator", context=self.context, namespace=rig.namespace)
        self.commands: list[tuple[float, float]] = []
        """When commands came, and how large the first input was."""
        self.replies: list[Any] = []
        driven, (low, high) = defaults(rig, "controller"), rig.limits
        self.fall = float(high[0] - low[0]) / (defaults(rig, "plant")["rate"] * driven["stop_seconds"])
        """By how much a stop brings the first input nearer to rest at a measurement."""
        border = Border(TYPES["joint_command"], steady=time.monotonic_ns)

        def note(data: bytes) -> None:
            came, message = time.perf_counter(), border.unpack(data)
            if message is not None:
                self.commands.append((came, float(message.lists[2][0])))

        self.node.create_subscription(TYPES["joint_command"], "joint_command", note, profile("joint_command"), raw=True)
        self.node.create_subscription(DiagnosticStatus, "command_reply", self.replies.append, 10)
        self.text = self.node.create_publisher(String, "command_text", 10)
        self.clients = {name: self.node.create_client(Trigger, f"commander/{name}") for name in ("stop", "home")}
        self.arming = self.node.create_client(SetBool, "commander/arm")
        self.setter = self.node.create_client(SetParameters, "commander/set_parameters")
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.spin)
        self.thread.start()

    def spin(self) -> None:
        while not self.ending.is_set():
            self.executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        self.ending.set()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()

    def until(self, condition: Callable[[], Any]) -> None:
        end = time.perf_counter() + PATIENCE
        while not condition():
            if self.ending.is_set():
                raise TimeoutError("the loop has ended")
            if time.perf_counter() > end:
                raise TimeoutError("the loop does not answer")
            time.sleep(0.01)

    def replied(self, count: int) -> bool:
        """Whether there are more replies than so many."""
        return len(self.replies) > count

    def swing(self, text: str) -> None:
        """Arm, and let the rig swing."""
        from std_msgs.msg import String
        from std_srvs.srv import SetBool

        self.until(self.arming.service_is_ready)
        armed = self.arming.call_async(SetBool.Request(data=True))
        self.until(armed.done)
        end = time.perf_counter() + PATIENCE
        while time.perf_counter() < end:  # it may still simulate what the rig reaches
            count = len(self.replies)
            self.text.publish(String(data=text))
            self.until(partial(self.replied, count))
            if any(item.key == "state" and item.value == "begins" for item in self.replies[count].values):
                return
            time.sleep(0.5)
        raise TimeoutError(self.replies[-1].message)

    def stop(self, way: str) -> float:
        """Stop once; seconds from the request to the first command that is nearer to rest by a stop's step or at it,
        with all after it so.
        """
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        replied = len(self.replies)
        before, asked = len(self.commands), time.perf_counter()
        if way == "service":
            self.clients["stop"].call_async(Trigger.Request())
        elif way == "topic":
            self.text.publish(String(data="stop"))
        else:
            wanted = Parameter("command", value="stop").to_parameter_msg()
            self.setter.call_async(SetParameters.Request(parameters=[wanted]))
        self.until(partial(self.replied, replied))
        self.until(lambda: len(self.commands) > before + 60)
        sizes = np.abs([value for _, value in self.commands[before:]])
        return self.commands[before + first_of_stop(sizes, self.fall)][0] - asked


def first_of_stop(sizes: Array, fall: float) -> int:
    """Which command is the first of a stop, of sizes (commands,) that come to 0 by about ``fall`` a command."""
    moving = np.flatnonzero(sizes)
    first = int(moving[-1]) + 1 if len(moving) else 0
    while first > 1 and sizes[first - 2] - sizes[first - 1] > 0.5 * fall:
        first -= 1
    return first


def measured(rig: Rig, domain: int, *, times: int) -> dict[str, list[float]]:
    """Seconds of stops at random moments of a swing, by the way in which they were asked for."""
    output = next(item for item in outputs_of(rig) if item.tracked)
    text = SWING.format(low=0.4 * output.low, high=0.4 * output.high, unit=output.unit)
    random = np.random.default_rng(0)
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    operator = Operator(rig, domain)

    def act() -> None:
        try:
            for way in track(WAYS * times, "stops", console=status):
                operator.swing(text)
                time.sleep(0.3 + random.uniform(0.0, 1.0))
                found[way].append(operator.stop(way))
        finally:
            if not operator.ending.is_set():
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # which ends the run

    with ThreadPoolExecutor(1) as pool:
        acting = pool.submit(act)
        try:
            Run(rig=rig.source, commander=True, domain=domain, tell=status.print).go()
        finally:
            operator.close()
        acting.result()
    return found
