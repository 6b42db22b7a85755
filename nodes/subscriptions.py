"""Subscriptions to topics of any publisher, and peers with incompatible quality of service."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum

from hybrid_sysid_ros.nodes.exchange import Exchange
from hybrid_sysid_ros.nodes.topics import OVERRIDES

UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""ROS's name for the node of an endpoint without a node."""


def name_of(peer: TopicEndpointInfo) -> str:
    """Full name of a peer's node."""
    if peer.node_name == UNKNOWN:
        return "a peer that is no ROS node"
    return f"{peer.node_namespace.rstrip('/')}/{peer.node_name}"


def unmatched(topic: str, quality: QoSProfile, peers: Iterable[TopicEndpointInfo]) -> list[str]:
    """A line for each peer that is incompatible with an endpoint of this quality of service, with the reason."""
    found = []
    for peer in peers:
        subscribes = peer.endpoint_type == TopicEndpointTypeEnum.SUBSCRIPTION
        offered, asked = (quality, peer.qos_profile) if subscribes else (peer.qos_profile, quality)
        compatibility, reason = qos_check_compatible(offered, asked)
        if compatibility == QoSCompatibility.ERROR:
            words = reason.replace("ERROR: ", "").strip("; ").lower()
            found.append(f"{topic}: nothing {'gets to' if subscribes else 'comes from'} {name_of(peer)}: {words}")
    return found


class Listener:
    """A subscription of serialised messages. Where a publisher offers only best effort, as drivers of sensors do, the
    subscription changes to best effort, which accepts both kinds of publishers and does not repeat lost messages.
    """

    def __init__(
        self,
        node: Node,
        kind: type[Any],
        topic: str,
        quality: QoSProfile,
        callback: Callable[..., None],
        *,
        soon: Callable[[Callable[[], None]], object],
    ) -> None:
        """kind: type of the messages; topic: its name, which rclpy resolves; soon: runs an action outside callbacks."""
        self._node, self._kind, self._topic, self._callback = node, kind, topic, callback
        self._name = node.resolve_topic_name(topic)
        self._refused = False
        self._soon = soon
        self._exchange: Exchange | None = None
        self._subscription: Subscription | None = self._subscribed(quality, OVERRIDES)

    def share(self, exchange: Exchange) -> None:
        """Also receive messages of this process through an exchange."""
        if self._subscription is not None:
            self._exchange = exchange
            exchange.subscribe(self._name, self._callback)

    def drain(self) -> None:
        """Handle all waiting messages."""
        subscription = self._subscription
        if subscription is not None:
            with subscription.handle:
                while (taken := subscription.handle.take_message(self._kind, True)) is not None:
                    self._callback(*taken)

    def publishers(self) -> int:
        """Number of publishers whose messages come here."""
        near = self._exchange.publishers(self._name) if self._exchange is not None else 0
        return near + (self._subscription.get_publisher_count() if self._subscription is not None else 0)

    def unmatched(self) -> list[str]:
        """Publishers whose messages can't come here, and why, a line each."""
        subscription = self._subscription
        if not self._refused or subscription is None:
            return []
        return unmatched(self._name, subscription.qos_profile, self._publishers())

    def _publishers(self) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(self._name))

    def make_do(self, policy: QoSPolicyKind) -> None:
        """Request only best effort, where a publisher offers no more; policy: the incompatible policy."""
        self._refused = True
        offers = [peer for peer in self._publishers() if peer.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT]
        if self._subscription is None or not (offers or policy == QoSPolicyKind.RELIABILITY):
            return
        quality = self._subscription.qos_profile
        if quality.reliability == ReliabilityPolicy.BEST_EFFORT:
            return
        who = ", ".join(map(name_of, offers)) or "a publisher"
        self._node.get_logger().warning(f"{self._name}: {who} offers best effort, which is used from now on")
        self._unsubscribe()
        quality.reliability = ReliabilityPolicy.BEST_EFFORT
        self._refused = False
        self._subscription = self._subscribed(quality)

    def close(self) -> None:
        """Close the subscription."""
        if self._exchange is not None:
            self._exchange.leave(self._name, self._callback)
            self._exchange = None
        self._unsubscribe()

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _subscribed(self, quality: QoSProfile, overrides: QoSOverridingOptions | None = None) -> Subscription:
        def refused(event: Any) -> None:
            self._soon(partial(self.make_do, event.last_policy_kind))

        events = SubscriptionEventCallbacks(incompatible_qos=refused)
        return self._node.create_subscription(
            self._kind,
            self._topic,
            self._callback,
            quality,
            raw=True,
            event_callbacks=events,
            qos_overriding_options=overrides,
        )
