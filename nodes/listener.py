"""Listener: what a node hears of a topic, from whoever publishes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from hybrid_sysid_ros.nodes.topics import OVERRIDES


class Listener:
    """A subscription of serialised messages. Where a publisher offers no more than best effort, as drivers of sensors
    do, the topic is heard so from then on: both kinds are heard then, and what is lost is not repeated.
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
        """kind: of the messages; topic: its name, for rclpy to resolve; soon: calls something outside of callbacks."""
        self._node, self._kind, self._topic, self._callback = node, kind, topic, callback
        self._soon = soon
        self._subscription: Subscription | None = self._subscribed(quality, OVERRIDES)

    def publishers(self) -> int:
        """How many there are whose messages come here."""
        return self._subscription.get_publisher_count() if self._subscription is not None else 0

    def make_do(self) -> None:
        """Ask for no more than best effort."""
        if self._subscription is None or self._is_best_effort(self._subscription):
            return
        self._node.get_logger().warning(
            f"{self._subscription.topic_name}: a publisher offers best effort: heard so from now on"
        )
        quality = self._subscription.qos_profile
        self.close()
        quality.reliability = ReliabilityPolicy.BEST_EFFORT
        self._subscription = self._subscribed(quality)

    @staticmethod
    def _is_best_effort(subscription: Subscription) -> bool:
        return bool(subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT)

    def close(self) -> None:
        """Hear nothing any more."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _subscribed(self, quality: QoSProfile, overrides: QoSOverridingOptions | None = None) -> Subscription:
        events = SubscriptionEventCallbacks(incompatible_qos=lambda event: self._soon(self.make_do))
        return self._node.create_subscription(
            self._kind,
            self._topic,
            self._callback,
            quality,
            raw=True,
            event_callbacks=events,
            qos_overriding_options=overrides,
        )
