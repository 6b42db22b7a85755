"""Graph client: asks the nodes of a ROS graph for their services, parameters, states and topics."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from time import monotonic
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.middleware import prepare_middleware
from hybrid_sysid_ros.nodes.parameters import OF_QUALITY
from hybrid_sysid_ros.support import errors, yaml_text
from hybrid_sysid_ros.support.errors import UserError

THERE_TIMEOUT = 5.0  # s, until a node is heard of
SETTLED = 1.0  # s without a new node, after which all are known
AGAIN = 1.0  # s, after which a question is repeated: an answer is lost where a service does not know its client yet
REPORTED = 1.0  # s, in which each node has reported its diagnostics
LEVELS = {
    DiagnosticStatus.OK: "OK", DiagnosticStatus.WARN: "WARN", DiagnosticStatus.ERROR: "ERROR",
    DiagnosticStatus.STALE: "STALE",
}  # fmt: skip
TRIGGER = "std_srvs/srv/Trigger"


class GraphClient:
    """A node that nobody lists, which asks the others. All methods return plain data."""

    def __init__(self, context: Context | None = None) -> None:
        """context: one that is initialised, by default a new one in the domain of ROS_DOMAIN_ID."""
        self._own = context is None
        if context is None:
            prepare_middleware()
            context = Context()
            rclpy.init(args=[], context=context)
        self._node = Node(
            f"_hybrid_sysid_{os.getpid()}", context=context, enable_rosout=False, start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._node.destroy_node()
        if self._own:
            self._node.context.try_shutdown()

    def services(self, *, namespace: str = "") -> list[str]:
        """The services that can be called, by their full names; namespace: of those that are meant, or "" for all."""
        found = self._settled(lambda: [name for name in self._triggers() if name.startswith(f"{namespace}/")])
        if not found:
            raise self._missing(f"no node with services{_in(namespace)}")
        return found

    def call(self, *, service: str, namespace: str = "", timeout: float = THERE_TIMEOUT) -> list[dict[str, Any]]:
        """Call a service of all nodes of a rig that offer it; what each answers.

        Raises UserError where no node offers it, those of several rigs do, or one does not answer.
        """
        if namespace and "/" in service.strip("/"):
            service = f"{namespace}/{service.removeprefix(f'{namespace}/')}"
        found = self._matching(self._triggers, service, namespace)
        if not found:
            self._refuse_others(service, namespace)
            offered = {name.rsplit("/", 1)[-1] for name in self._triggers() if name.startswith(f"{namespace}/")}
            raise self._missing(f"no node{_in(namespace)} offers the service {service}", service, offered)
        _check_one({name.rsplit("/", 2)[0] for name in found}, f"the service {service} is offered")
        found.sort(key=lambda name: not name.endswith(f"/plant/{name.rsplit('/', 1)[-1]}"))  # the others follow the rig
        answers = [(name, self._ask(Trigger, name, Trigger.Request(), timeout)) for name in found]
        return [{"service": name, "done": answer.success, "message": answer.message} for name, answer in answers]

    def get(
        self, *, node: str, names: Sequence[str] = (), namespace: str = "", timeout: float = THERE_TIMEOUT
    ) -> dict[str, Any]:
        """Values and descriptions of parameters of a node, by default all but overrides of qualities.

        Raises UserError where there is no such node or parameter, those of several rigs have the name, or it does not
        answer.
        """
        full, known = self._parameters_of(node, names, namespace, timeout)
        chosen = list(names) or [name for name in known if not name.startswith(OF_QUALITY)]
        answer = self._ask(GetParameters, f"{full}/get_parameters", GetParameters.Request(names=chosen), timeout)
        described = self._descriptors(full, chosen, timeout)
        parameters = [
            {"name": name, "value": _plain(value), "description": _description(descriptor)}
            for name, value, descriptor in zip(chosen, answer.values, described, strict=True)
        ]
        return {"node": full, "parameters": parameters}

    def set(
        self, *, node: str, values: Mapping[str, str], namespace: str = "", timeout: float = THERE_TIMEOUT
    ) -> dict[str, Any]:
        """Set parameters of a node, all or none, by what was typed for each; what they are now.

        Raises UserError where get() does, a value makes no sense, or the node refuses one, with its reason.
        """
        full, _ = self._parameters_of(node, list(values), namespace, timeout)
        descriptors = self._descriptors(full, list(values), timeout)
        wanted = {
            name: _typed(name, text, descriptor.type)
            for (name, text), descriptor in zip(values.items(), descriptors, strict=True)
        }
        try:
            messages = [Parameter(name, value=value).to_parameter_msg() for name, value in wanted.items()]
        except TypeError as error:
            raise UserError(f"{', '.join(wanted)}: ROS has no parameter of such values: {error}") from error
        request = SetParametersAtomically.Request(parameters=messages)
        result = self._ask(SetParametersAtomically, f"{full}/set_parameters_atomically", request, timeout).result
        if not result.successful:
            raise UserError(f"{full} refuses {', '.join(wanted)}: {result.reason or 'it gives no reason'}")
        return {"node": full, "values": wanted}

    def nodes(self) -> list[dict[str, Any]]:
        """All nodes, with what each reports of its tasks in the diagnostics."""
        reported: dict[str, dict[str, dict[str, str]]] = {}

        def take(message: DiagnosticArray) -> None:
            for status in message.status:
                node, _, task = status.name.rpartition(": ")
                own = reported.setdefault(f"/{node}", {})
                own[task] = {"task": task, "level": LEVELS[status.level], "message": status.message}

        self._node.create_subscription(DiagnosticArray, "/diagnostics", take, topics.profile("/diagnostics"))
        if not self._settled(self._names):
            raise self._missing("no node")
        self._spin(lambda: None, REPORTED)
        return [{"node": name, "tasks": [*reported.get(name, {}).values()]} for name in self._names()]

    def topics(self, *, seconds: float = 0.0) -> list[dict[str, Any]]:
        """All topics with their types, and the rates of their messages over so many seconds; 0 measures none."""
        if not self._settled(self._names):
            raise self._missing("no node")
        found: list[dict[str, Any]] = [
            {"topic": name, "type": types[0], "publishers": len(self._publishers(name)), "hz": None}
            | {"subscriptions": self._node.count_subscribers(name)}
            for name, types in sorted(self._node.get_topic_names_and_types())
        ]
        if seconds:
            counts = {item["topic"]: count for item in found if (count := self._counted(item["topic"], item["type"]))}
            self._spin(lambda: None, SETTLED)  # until they are connected
            before = {name: count[0] for name, count in counts.items()}
            self._spin(lambda: None, seconds)
            for item in found:
                if item["topic"] in counts:
                    item["hz"] = (counts[item["topic"]][0] - before[item["topic"]]) / seconds
        return found

    def _counted(self, topic: str, kind: str) -> list[int] | None:
        """A count of the messages of a topic from now on; None where nobody publishes or the type is unknown."""
        offered = self._publishers(topic)
        message = topics.type_of(kind)
        if message is None or not offered:
            return None
        count = [0]

        def add(_: bytes) -> None:
            count[0] += 1

        reliable = all(item.qos_profile.reliability == ReliabilityPolicy.RELIABLE for item in offered)
        quality = QoSProfile(
            depth=1000,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )
        self._node.create_subscription(message, topic, add, quality, raw=True)
        return count

    def _publishers(self, topic: str) -> list[Any]:
        own = self._node.get_name()
        return [item for item in self._node.get_publishers_info_by_topic(topic) if item.node_name != own]

    def _parameters_of(
        self, node: str, names: Collection[str], namespace: str, timeout: float
    ) -> tuple[str, list[str]]:
        """Full name of a node, and the names of its parameters, among which are these."""
        if namespace and not node.startswith("/"):
            node = f"{namespace}/{node}"
        found = self._matching(self._names, node, namespace)
        if not found:
            raise self._missing(f"no node {node}", node, self._names())
        _check_one(set(found), f"the name {node} is that of")
        answer = self._ask(ListParameters, f"{found[0]}/list_parameters", ListParameters.Request(), timeout)
        known = sorted(answer.result.names)
        for name in names:
            if name not in known:
                own = [item for item in known if not item.startswith(OF_QUALITY)]
                raise UserError(f"{found[0]} has no parameter {name}: {errors.known(name, own)}")
        return found[0], known

    def _descriptors(self, full: str, names: list[str], timeout: float) -> list[Any]:
        request = DescribeParameters.Request(names=names)
        return list(self._ask(DescribeParameters, f"{full}/describe_parameters", request, timeout).descriptors)

    def _names(self) -> list[str]:
        """Full names of all nodes, but for hidden ones."""
        pairs = self._node.get_node_names_and_namespaces()
        return sorted({f"{space.rstrip('/')}/{name}" for name, space in pairs if not name.startswith("_")})

    def _triggers(self) -> list[str]:
        """Full names of the services of one type that nodes offer."""
        return sorted(name for name, kinds in self._offered().items() if TRIGGER in kinds)

    def _refuse_others(self, service: str, namespace: str) -> None:
        """Raise UserError where a service is there, but of another type than one that call() takes."""
        for name, kinds in self._offered().items():
            if name == service or (name.endswith(f"/{service}") and name.startswith(f"{namespace}/")):
                raise UserError(
                    f"{name} is of type {kinds[0]}, and only {TRIGGER} is called here: use ros2 service call {name} "
                    f"{kinds[0]}, or set a parameter of its node"
                )

    def _offered(self) -> dict[str, Sequence[str]]:
        """Types of the services that nodes offer; the names that ROS has of all are of their clients, too."""
        found: dict[str, Sequence[str]] = {}
        for full in self._names():
            with suppress(rclpy_implementation.NodeNameNonExistentError):  # it has gone
                space, _, name = full.rpartition("/")
                found |= dict(self._node.get_service_names_and_types_by_node(name, space or "/"))
        return found

    def _matching(self, look: Callable[[], list[str]], wanted: str, namespace: str) -> list[str]:
        """The full names that are meant by one; a full one needs no look for others."""
        if wanted.startswith("/"):
            return [wanted] if self._spin(lambda: wanted in look(), THERE_TIMEOUT) else []
        ending = f"/{wanted}"
        return self._settled(
            lambda: [name for name in look() if name.endswith(ending) and name.startswith(f"{namespace}/")]
        )

    def _settled(self, look: Callable[[], list[str]]) -> list[str]:
        """What is found once nothing new has come for SETTLED, or nothing at all in THERE_TIMEOUT."""
        found: list[str] = self._spin(look, THERE_TIMEOUT)
        while more := self._spin(partial(_other, look, found), SETTLED):
            found = more
        return found

    def _spin(self, done: Callable[[], Any], seconds: float) -> Any:
        """Go on until something is found or the time is over; returns what is found."""
        end = monotonic() + seconds
        while not (found := done()) and (left := end - monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.02))
        return found

    def _ask(self, kind: Any, service: str, request: Any, timeout: float) -> Any:
        """What a service answers. Raises UserError where it does not."""
        client = self._node.create_client(kind, service)
        try:
            answers: list[Any] = []
            if self._spin(client.service_is_ready, timeout):
                for begin in range(max(round(timeout / AGAIN), 1)):
                    answers.append(client.call_async(request))
                    wait = min(AGAIN, timeout - begin * AGAIN)
                    if self._spin(lambda: any(answer.done() for answer in answers), wait):
                        return next(answer.result() for answer in answers if answer.done())
            raise UserError(
                f"{service} does not answer within {timeout:g} s: see how its node is by hybrid-sysid nodes, or wait "
                "longer with --timeout"
            )
        finally:
            self._node.destroy_client(client)

    def _missing(self, what: str, name: str = "", names: Collection[str] = ()) -> UserError:
        """What is not there, and what is instead."""
        advice = errors.known(name, sorted(names)) if names else "start it with hybrid-sysid run, or give its --domain"
        domain = self._node.context.get_domain_id()
        return UserError(f"{what} in ROS domain {domain}, looked for {THERE_TIMEOUT:g} s: {advice}")


def _other(look: Callable[[], list[str]], known: list[str]) -> list[str]:
    found = look()
    return found if found != known else []


def _in(namespace: str) -> str:
    return f" in {namespace}" if namespace else ""


def _check_one(names: set[str], what: str) -> None:
    if len(names) > 1:
        raise UserError(f"{what} in {', '.join(sorted(names))}: give --rig, or the full name")


def _plain(value: Any) -> Any:
    """The value of a parameter as JSON has it."""
    found = parameter_value_to_python(value)
    return list(found) if hasattr(found, "__iter__") and not isinstance(found, str) else found


def _description(descriptor: Any) -> str:
    """What a node says of a parameter, with its range."""
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    within = [f"within [{item.from_value:g}, {item.to_value:g}]" for item in ranges]
    return "; ".join(filter(None, (descriptor.description, *within, descriptor.additional_constraints)))


def _typed(name: str, text: str, kind: int) -> Any:
    """What was typed for a parameter, as its type wants it. Raises UserError where it makes no sense."""
    if kind == ParameterType.PARAMETER_STRING:
        return text
    try:
        value = yaml_text.parsed(text)
    except yaml_text.TextError as error:
        raise UserError(f"{name}={text}: is no value: {error}") from error
    if kind == ParameterType.PARAMETER_DOUBLE_ARRAY and isinstance(value, list):
        return [_number(item) for item in value]
    return _number(value) if kind in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY) else value


def _number(value: Any) -> Any:
    return float(value) if type(value) is int else value


def main() -> int:
    """Answer the question of the command line, in JSON; the exit status."""
    given = json.loads(sys.argv[1])
    try:
        client = GraphClient()
        try:
            print(json.dumps(getattr(client, given.pop("question"))(**given)))
        finally:
            client.close()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
