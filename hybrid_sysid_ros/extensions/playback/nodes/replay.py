"""Replay: what a bag recorded of a loop goes through estimator and controller again, into another bag.

The nodes are those of the loop, in this process and without a middleware between them: what they would hear is handed
to them, and what they publish is taken. Time is that of the bag.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.clock import ROSClock
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rclpy.time import Time

from hybrid_sysid_ros.bags import BagWriter
from hybrid_sysid_ros.bags.bag import Bag, opened
from hybrid_sysid_ros.nodes import middleware
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.validation import MessageValidator
from hybrid_sysid_ros.support.errors import UserError

_Kind = TypeVar("_Kind", bound=RigNode)
HEARD = ("joint_states", "reference", "state_estimate")
CHANGES = "/parameter_events"
Change = tuple[int, list[Parameter]]


@dataclass(frozen=True, kw_only=True)
class ReplayTask:
    """What is to be replayed."""

    bag: str
    out: str
    """Folder of the bag to write: measurements and references as they were, estimates and commands as they are now."""
    namespace: str
    estimator: Mapping[str, Any]
    controller: Mapping[str, Any]
    fixed: Sequence[str] = ()
    """Parameters that stay as they are, also where they were changed while the bag was recorded."""
    recover: bool = False


class Tap:
    """Takes what a node would publish."""

    def __init__(self) -> None:
        self._taken: list[bytes] = []

    def publish(self, data: bytes) -> None:
        """Take a serialised message."""
        self._taken.append(bytes(data))

    def taken(self) -> list[bytes]:
        """Hand out what has come since the last time."""
        found, self._taken = self._taken, []
        return found


class Replay:
    """Estimator and controller, and what they answer to what a bag recorded, message by message.

    An estimate reaches the controller when the recorded one did, so that references come between as they did.
    """

    def __init__(self, context: Context, order: ReplayTask) -> None:
        """Raises UserError when a parameter is not as nodes.yaml says, or a folder cannot be loaded."""
        self.estimator = _made(EstimatorNode, context, order.namespace, order.estimator)
        self.controller = _made(ControllerNode, context, order.namespace, order.controller)
        self.estimates, self.commands = Tap(), Tap()
        self.estimator.estimates, self.controller.output.commands = self.estimates, self.commands
        self.waiting: dict[int, bytes] = {}
        """Estimates that have not reached the controller, by their stamps [ns]."""
        self.due: set[int] = set()
        """Stamps of recorded estimates, until those of now have reached it."""
        self.changes: dict[RigNode, deque[tuple[int, list[Parameter]]]] = {
            self.estimator: deque(),
            self.controller: deque(),
        }
        """Parameters that the nodes have yet to get, and the stamp of the first message that they answer with them."""

    def deliver(self, topic: str, logged: int, data: bytes) -> Iterator[tuple[str, bytes]]:
        """Topic and data of what is answered to a message of a topic that was logged then [ns]."""
        if topic == "joint_states":
            self._change(self.estimator, self._stamp(data))
            self._tell(self.estimator, self.estimator.entry, self.estimator.on_measurement, logged, data)
            for estimate in self.estimates.taken():
                self.waiting[self._stamp(estimate)] = estimate
        elif topic == "reference":
            self._tell(self.controller, self.controller.wishes, self.controller.on_reference, logged, data)
        elif topic == "state_estimate":
            self.due.add(self._stamp(data))
        for stamp in sorted(self.due & self.waiting.keys()):
            self.due.discard(stamp)
            estimate = self.waiting.pop(stamp)
            yield "state_estimate", estimate
            self._change(self.controller, stamp)
            self._tell(self.controller, self.controller.entry, self.controller.on_estimate, logged, estimate)
        yield from (("joint_command", command) for command in self.commands.taken())

    def foresee(self, bag: Bag, order: ReplayTask) -> None:
        """Learn what was changed while the bag was recorded. By the new values a node gave the first answer that lies
        behind the change, whenever what it answers had come.
        """
        if CHANGES not in bag.topics:
            return
        events = [(logged, deserialize_message(data, ParameterEvent)) for _, logged, data in bag.messages([CHANGES])]
        for node, topic in ((self.estimator, "state_estimate"), (self.controller, "joint_command")):
            wanted = deque((at, event) for at, event in events if event.node == node.get_fully_qualified_name())
            for _, logged, data in bag.messages([f"{order.namespace}/{topic}"]):
                while wanted and wanted[0][0] <= logged:
                    given = map(Parameter.from_parameter_msg, wanted.popleft()[1].changed_parameters)
                    kept = [item for item in given if item.name not in order.fixed]
                    self.changes[node].append((self._stamp(data), kept))

    def _change(self, node: RigNode, stamp: int) -> None:
        """Give a node the parameters with which it answers a message of this stamp [ns]."""
        waiting = self.changes[node]
        while waiting and waiting[0][0] <= stamp:
            for result in node.set_parameters(waiting.popleft()[1]):
                if not result.successful:
                    node.get_logger().warning(f"not changed as it was recorded: {result.reason}")

    def _stamp(self, estimate: bytes) -> int:
        joints = self.controller.entry.unpack(estimate)
        return 0 if joints is None else int(joints.stamp)

    @staticmethod
    def _tell(
        node: RigNode, validator: MessageValidator, callback: Callable[[Any], None], logged: int, data: bytes
    ) -> None:
        clock = node.get_clock()
        if isinstance(clock, ROSClock) and clock.ros_time_is_active:
            clock.set_ros_time_override(Time(nanoseconds=logged, clock_type=clock.clock_type))
        message = validator.unpack(data)
        if message is not None:
            callback(message)


def _made(kind: Callable[..., _Kind], context: Context, namespace: str, values: Mapping[str, Any]) -> _Kind:
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return kind(context=context, namespace=namespace, parameter_overrides=overrides)


def replay(order: ReplayTask) -> None:
    """Replay a bag into another. Raises UserError where it is damaged or lacks a topic, or a node can't be made."""
    topics = {f"{order.namespace}/{topic}": topic for topic in HEARD}
    with opened(order.bag, recover=order.recover) as bag, BagWriter(order.out, replace=True) as out:
        types = {name: bag.topics[name].type for name in topics if name in bag.topics}
        if missing := [name for name in topics if name not in types]:
            raise UserError(f"{order.bag}: no topic {missing[0]}: the bag has {bag.listing}")
        context = Context()
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"  # nobody else is to hear of these nodes
        rclpy.init(args=[], context=context)
        try:
            loop = Replay(context, order)
            loop.foresee(bag, order)
            for name, logged, data in bag.messages(types):
                topic = topics[name]
                if topic != "state_estimate":
                    out.write_raw(name, types[name], logged, data)
                for answer, message in loop.deliver(topic, logged, data):
                    out.write_raw(f"{order.namespace}/{answer}", "sensor_msgs/msg/JointState", logged, message)
        finally:
            context.try_shutdown()


def main() -> int:
    """Replay what the argument says, a :class:`ReplayTask` in JSON; return the exit status, 2 where it is wrong."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing half-written is left
    middleware.prepare_middleware()
    try:
        replay(ReplayTask(**json.loads(sys.argv[1])))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
