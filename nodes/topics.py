"""Topics: the message type of each topic of a rig, and the QoS profile that the configuration gives it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.runtime.configuration import Quality
from hybrid_sysid_ros.support.errors import UserError

TYPES: Mapping[str, Any] = {
    "joint_states": JointState,
    "joint_command": JointState,
    "state_estimate": JointState,
    "state_covariance": Float64MultiArray,
    "reference": JointTrajectory,
    "predicted_trajectory": JointTrajectory,
    "/diagnostics": DiagnosticArray,
}


def profile(qualities: Mapping[str, Quality], topic: str, *, depth: int | None = None) -> QoSProfile:
    """QoS of a topic; `depth` where a reader needs a longer queue. Raises UserError where the configuration has no
    class for the topic.
    """
    if topic not in qualities:
        raise UserError(f"configuration: no class in section qos has the topic {topic}: add it to one")
    quality = replace(qualities[topic], depth=depth or qualities[topic].depth)
    return QoSProfile(
        depth=quality.depth,
        reliability=ReliabilityPolicy[quality.reliability.upper()],
        durability=DurabilityPolicy[quality.durability.upper()],
    )
