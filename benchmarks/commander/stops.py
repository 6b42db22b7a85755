"""Stops: from a request to the first command towards rest, in a loop of processes in real time."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from rich.progress import track

from hybrid_sysid_ros.commands.terminal import status
from hybrid_sysid_ros.extensions.commander.companion import Commander
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array

WAYS = ("service", "topic", "parameter")
STATES: Mapping[str, Sequence[str]] = {
    "moving": WAYS,
    "checking": WAYS,
    "waiting": WAYS,
    "starting": WAYS,
    "inactive": ("service", "parameter"),
    "unconfigured": ("service", "parameter"),
}
"""Of the commander, while the rig swings, and the ways in which a stop can be asked for there: who is not active hears
no topic.
"""
SWING = "swing between {low:.3g} and {high:.3g} {unit} at 0.5 Hz for {seconds:g} s"
SHORT, LONG = 14.0, 60.0  # s, of a plan that is carried out, and of one that takes long to check
PATIENCE = 120.0  # s, with anything: what simulates gives way on a busy machine
FOUND = 0.2  # s, until peers have found each other's new topics
AT_REST, LOOKED_AT = 20, 400  # commands behind a stop, and of those about one


class Operator:
    """Speaks to a commander and watches the commands."""

    def __init__(self, rig: Rig, domain: int, *, seed: int) -> None:
        """seed: of the moments at which a stop comes."""
        import rclpy
        from diagnostic_msgs.msg import DiagnosticStatus
        from lifecycle_msgs.srv import ChangeState
        from rcl_interfaces.srv import SetParameters
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import String
        from std_srvs.srv import SetBool, Trigger

        from hybrid_sysid_ros.nodes.topics import TYPES, profile
        from hybrid_sysid_ros.nodes.validation import MessageValidator

        self.output = next(item for item in set_point_ranges(rig) if item.tracked)
        self.random = np.random.default_rng(seed)
        self.context = rclpy.context.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("operator", context=self.context, namespace=rig.namespace)
        self.commands: list[tuple[float, float]] = []
        """When commands were published [s, system time], and how far from rest the first input was."""
        self.replies: list[Any] = []
        (low, high), rest, seconds = rig.limits, rig.actuators[0].rest, defaults(rig, "controller")["stop_seconds"]
        self.fall = float(high[0] - low[0]) / (defaults(rig, "plant")["rate"] * seconds)
        """By how much a stop brings the first input nearer to rest at a measurement."""
        validator = MessageValidator(TYPES["joint_command"], steady=time.monotonic_ns)

        def note(data: bytes, information: Mapping[str, int]) -> None:
            message = validator.unpack(data)
            if message is not None:
                published = information["source_timestamp"] * 1e-9  # not when it came: this process may wait its turn
                self.commands.append((published, abs(float(message.lists[2][0]) - rest)))

        self.node.create_subscription(TYPES["joint_command"], "joint_command", note, profile("joint_command"), raw=True)
        self.node.create_subscription(DiagnosticStatus, "command_reply", self.replies.append, 10)
        self.text = self.node.create_publisher(String, "command_text", 10)
        self.stopping = self.node.create_client(Trigger, "commander/stop")
        self.arming = self.node.create_client(SetBool, "commander/arm")
        self.setter = self.node.create_client(SetParameters, "commander/set_parameters")
        self.manager = self.node.create_client(ChangeState, "commander/change_state")
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

    def call(self, client: Any, **request: Any) -> Any:
        """The answer of a service."""
        self.until(client.service_is_ready)
        answer = client.call_async(client.srv_type.Request(**request))
        self.until(answer.done)
        return answer.result()

    def plan(self, seconds: float) -> str:
        """A text that lets the rig swing for so long."""
        low, high = (0.4 * end for end in (self.output.low, self.output.high))
        return SWING.format(low=low, high=high, unit=self.output.unit, seconds=seconds)

    def replied(self, text: str, since: int) -> str:
        """The state that the commander replied with to a text, "" if it has not since there were so many replies."""
        for reply in self.replies[since:]:
            reported = {item.key: item.value for item in reply.values}
            if reported["text"] == text:
                return reported["state"]
        return ""

    def say(self, text: str) -> str:
        """The same, when it comes."""
        from std_msgs.msg import String

        since = len(self.replies)
        self.text.publish(String(data=text))
        self.until(lambda: self.replied(text, since))
        return self.replied(text, since)

    def swing(self) -> None:
        """Arm, and let the rig swing for a while."""
        end = time.perf_counter() + PATIENCE
        self.call(self.arming, data=True)
        while self.say(self.plan(SHORT)) != "begins":  # it may still simulate what the rig reaches
            if time.perf_counter() > end:
                raise TimeoutError(self.replies[-1].message)
            time.sleep(0.2)
        time.sleep(0.3 + self.random.uniform(0.0, 1.0))

    def enter(self, state: str) -> None:
        """Bring the commander into a state, the rig moving all the while."""
        from std_msgs.msg import String

        if state == "checking":
            since = len(self.replies)
            self.text.publish(String(data=self.plan(LONG)))
            time.sleep(0.1)
            if found := self.replied(self.plan(LONG), since):
                raise RuntimeError(f"a long plan {found}: it should still be checked")
        elif state == "waiting":
            self.call(self.arming, data=False)
            if (found := self.say(self.plan(SHORT))) != "waits":
                raise RuntimeError(f"a plan of a disarmed commander {found}")
        elif state == "starting":
            self.change("deactivate", "activate")
            if (found := self.say(self.plan(SHORT))) != "refused":
                raise RuntimeError(f"a plan {found} before the commander knows what the rig reaches")
        elif state != "moving":
            self.change("deactivate", *(["cleanup"] if state == "unconfigured" else []))

    def leave(self, state: str) -> None:
        """Let it hear again."""
        self.change(*{"inactive": ["activate"], "unconfigured": ["configure", "activate"]}.get(state, []))

    def change(self, *names: str) -> None:
        """Change the commander's state as a manager does."""
        from lifecycle_msgs.msg import Transition

        for name in names:
            transition = Transition(id=getattr(Transition, f"TRANSITION_{name.upper()}"))
            if not self.call(self.manager, transition=transition).success:
                raise RuntimeError(f"the commander does not {name}")
            if name in ("activate", "deactivate"):
                self.until(partial(self.is_heard, name == "activate"))
                time.sleep(FOUND)

    def is_heard(self, wanted: bool) -> bool:
        """Whether somebody hears texts, or nobody does, as is wanted."""
        return bool(self.text.get_subscription_count()) == wanted

    def stop(self, way: str) -> tuple[float, int]:
        """Stop once; seconds from the request to the first command that is nearer to rest by a stop's step or at it,
        with all after it so, and how many came meanwhile that were not.
        """
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        asked = time.time()
        if way == "service":
            self.stopping.call_async(Trigger.Request())
        elif way == "topic":
            self.text.publish(String(data="stop"))
        else:
            wanted = Parameter("command", value="stop").to_parameter_msg()
            self.setter.call_async(SetParameters.Request(parameters=[wanted]))
        self.until(partial(self.rests, asked))
        published, sizes = np.array(self.commands[-LOOKED_AT:]).T
        last = int(np.searchsorted(published, asked)) - 1
        first = first_of_stop(sizes[last:], self.fall)
        return float(published[last + first]) - asked, first - 1

    def rests(self, since: float) -> bool:
        """Whether the newest commands are at rest, and some were published since a time [s]."""
        newest = self.commands[-AT_REST:]
        return newest[0][0] > since and not any(size for _, size in newest)


def first_of_stop(sizes: Array, fall: float) -> int:
    """Which command is the first of a stop, of sizes (commands,) that come to 0 by about ``fall`` a command; the first
    of all came before it.
    """
    moving = np.flatnonzero(sizes)
    first = int(moving[-1]) + 1 if len(moving) else 1
    while first > 1 and sizes[first - 2] - sizes[first - 1] > 0.5 * fall:
        first -= 1
    return first


Stops = dict[str, dict[str, list[tuple[float, int]]]]
"""By the commander's state and the way in which they were asked for: see :meth:`Operator.stop`."""


def measured(rig: Rig, domain: int, *, times: int, seed: int = 0) -> Stops:
    """Stops at random moments of a swing."""
    found: Stops = {state: {way: [] for way in ways} for state, ways in STATES.items()}
    operator = Operator(rig, domain, seed=seed)

    def act() -> None:
        wanted = [(state, way) for state, ways in STATES.items() for way in ways] * times
        try:
            for state, way in track(wanted, "stops", console=status):
                operator.swing()
                operator.enter(state)
                found[state][way].append(operator.stop(way))
                operator.leave(state)
        finally:
            if not operator.ending.is_set():
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # which ends the run

    with ThreadPoolExecutor(1) as pool:
        acting = pool.submit(act)
        try:
            Run(rig=rig.source, companions=[Commander()], domain=domain, tell=status.print).go()
        finally:
            operator.close()
        acting.result()
    return found
