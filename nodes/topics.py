"""Topics: the message type of each topic of a rig, and its QoS profile from the configuration."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.bags import QualityOfService
from hybrid_sysid_ros.nodes.validation import LARGEST
from hybrid_sysid_ros.runtime.parameters import DECLARATIONS, read_declarations
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, read_mapping, section

OWN: Mapping[str, Any] = {
    "joint_states": JointState,
    "joint_command": JointState,
    "effort_command": Float64MultiArray,
    "state_estimate": JointState,
    "state_covariance": Float64MultiArray,
    "reference": JointTrajectory,
    "set_point": JointTrajectory,
    "predicted_trajectory": JointTrajectory,
    "motion": JointTrajectory,
    "camera/joint_states": JointState,
    "estop": Bool,
    "/diagnostics": DiagnosticArray,
    "/parameter_events": ParameterEvent,
    "/rosout": Log,
}
UNRECORDED = ("effort_command", "motion")
"""Topics that repeat joint_command, or that only a simulated camera reads."""

OVERRIDDEN: Mapping[str, tuple[str, ...]] = {
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "depth": (),
}
"""Policies of a topic that a user may set by the parameters qos_overrides.TOPIC.ENTITY.POLICY."""
OVERRIDES = QoSOverridingOptions([QoSPolicyKind[name.upper()] for name in OVERRIDDEN])
LONGEST = 100_000  # messages that a topic may keep
ENTITIES = ("publisher", "subscription")


@dataclass(frozen=True, kw_only=True)
class FurtherTopic:
    """A topic that an extension declares."""

    type: str
    """Message type, such as sensor_msgs/msg/JointState."""
    largest: int = LARGEST
    """Most bytes of a message."""
    recorded: bool = True
    """Whether a recorder without a list of topics records it."""


def _further() -> Iterator[tuple[str, FurtherTopic, Any]]:
    """Name, declaration and message class of the extensions' topics. One that is declared wrongly, or whose message is
    not installed, is left out.
    """
    for path in read_declarations()[0][1:]:
        topics = read_mapping(path).get("topics") or {}
        for name in topics:
            try:
                topic: FurtherTopic = built(FurtherTopic, topics[name], f"{path}: topics.{name}")
                if name in OWN:
                    raise UserError(f"{path}: topics.{name}: there is such a topic already: give it another name")
                if (kind := type_of(topic.type)) is None:
                    raise UserError(f"{path}: topics.{name}: {topic.type} is not installed")
                yield name, topic, kind
            except UserError as error:
                extensions.leave_out("a topic", error)


def type_of(name: str) -> Any | None:
    """The class of a message type, such as sensor_msgs/msg/JointState; None where it is not installed."""
    package, _, kind = name.rpartition("/")
    try:
        return getattr(import_module(package.replace("/", ".")), kind)
    except (ImportError, AttributeError, ValueError):
        return None


class MessageTypes(dict[str, Any]):
    """Message classes by topic. Raises UserError for a topic that is left out."""

    def __missing__(self, topic: str) -> Any:
        raise UserError(f"topic {topic}: no extension that is used declares it{extensions.left_out()}")


FURTHER = tuple(_further())
TYPES: Mapping[str, Any] = MessageTypes({**OWN, **{name: kind for name, _, kind in FURTHER}})
"""Message classes of all topics."""
LARGEST_OF: Mapping[str, int] = {name: topic.largest for name, topic, _ in FURTHER}
RECORDED = (*(name for name in OWN if name not in UNRECORDED), *(name for name, topic, _ in FURTHER if topic.recorded))


def check_override(name: str, value: Any, carried: Mapping[str, Collection[str]]) -> None:
    """Raise UserError for a wrong parameter qos_overrides.TOPIC.ENTITY.POLICY.

    carried: full names of the node's topics by entity.
    """
    topic, entity, policy = (*name.removeprefix("qos_overrides.").rsplit(".", 2), "", "")[:3]
    if entity not in ENTITIES or policy not in OVERRIDDEN:
        raise UserError(
            f"parameter {name}: needs the form qos_overrides.TOPIC.{'|'.join(ENTITIES)}.{'|'.join(OVERRIDDEN)}"
        )
    if topic not in carried[entity]:
        known = ", ".join(sorted(carried[entity])) or "none"
        raise UserError(f"parameter {name}: the node has no {entity} of {topic}: it has {known}")
    if policy == "depth":
        if type(value) is not int or not 1 <= value <= LONGEST:
            raise UserError(f"parameter {name} is {value!r}: it needs a whole number within 1 and {LONGEST}")
        return
    if value not in OVERRIDDEN[policy]:
        raise UserError(f"parameter {name} is {value!r}: choose one of {', '.join(OVERRIDDEN[policy])}")


@cache
def qualities(*files: Path) -> dict[str, dict[str, Any]]:
    """Settings of each topic's QoS profile by its name, from msgs_config/nodes.yaml and the extensions' files.

    Raises UserError where a class is declared wrongly, or names a topic of another class.
    """
    found: dict[str, dict[str, Any]] = {}
    classes = [(path, section(read_mapping(path), "qos", str(path))) for path in files or read_declarations()[0]]
    for path, name, entry in ((path, name, entry) for path, entries in classes for name, entry in entries.items()):
        try:
            policies = {"reliability": ReliabilityPolicy, "durability": DurabilityPolicy}
            settings = {key: policy[entry[key].upper()] for key, policy in policies.items()}
            settings, carried = {**settings, "depth": int(entry["depth"])}, set(entry["topics"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError(f"{path}: qos.{name}: needs reliability, durability, depth and topics") from error
        if twice := carried & found.keys():
            raise UserError(f"{path}: qos.{name}: topic {min(twice)} is in another class already")
        found |= dict.fromkeys(carried, settings)
    return found


def profile(topic: str, *, depth: int | None = None) -> QoSProfile:
    """QoS of a topic; `depth` where a reader needs a longer queue. Raises UserError where no class has the topic."""
    if topic not in qualities():
        raise UserError(f"{DECLARATIONS}: no class in section qos has the topic {topic}: add it to one")
    settings = qualities()[topic]
    return QoSProfile(**{**settings, "depth": depth or settings["depth"]})


def qualities_of(publishers: Iterable[Any]) -> list[QualityOfService]:
    """Qualities of service of publishers, from rclpy's information."""
    profiles = [publisher.qos_profile for publisher in publishers]
    return [
        QualityOfService(
            reliability=profile.reliability.name.lower(),
            durability=profile.durability.name.lower(),
            history=profile.history.name.lower(),
            depth=profile.depth,
        )
        for profile in profiles
    ]
