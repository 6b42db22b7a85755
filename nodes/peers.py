"""Peers: who is at the other end of a topic, and what keeps messages from passing."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum

UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""What ROS calls the node of an endpoint that has none."""


def name_of(peer: TopicEndpointInfo) -> str:
    """Full name of a peer's node."""
    if peer.node_name == UNKNOWN:
        return "a peer that is no ROS node"
    return f"{peer.node_namespace.rstrip('/')}/{peer.node_name}"


def unmatched(topic: str, quality: QoSProfile, peers: Iterable[TopicEndpointInfo]) -> list[str]:
    """Those peers of an endpoint with this quality of service between whom and it nothing passes, and why."""
    found = []
    for peer in peers:
        hears = peer.endpoint_type == TopicEndpointTypeEnum.SUBSCRIPTION
        offered, asked = (quality, peer.qos_profile) if hears else (peer.qos_profile, quality)
        compatibility, reason = qos_check_compatible(offered, asked)
        if compatibility == QoSCompatibility.ERROR:
            words = reason.replace("ERROR: ", "").strip("; ").lower()
            found.append(f"{topic}: nothing {'gets to' if hears else 'comes from'} {name_of(peer)}: {words}")
    return found
