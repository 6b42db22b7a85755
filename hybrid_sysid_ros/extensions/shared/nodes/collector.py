"""Collector: a subscription whose messages wait until somebody fetches them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

DEPTH = 1000  # messages that wait; older ones are lost


class Uncalled(CallbackGroup):
    """Callback group of entities that no executor serves."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class Collector:
    """A best-effort subscription of serialised messages: publishers do not wait for it, and it accepts both kinds of
    publishers.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str) -> None:
        """kind: type of the messages; topic: its name, which rclpy resolves."""
        quality = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node, self._kind = node, kind
        self._subscription = node.create_subscription(
            kind, topic, lambda data: None, quality, raw=True, callback_group=Uncalled()
        )

    def fetch(self) -> Iterator[tuple[bytes, int]]:
        """Messages since the last call, each with its time of publishing [ns, system time]."""
        handle = self._subscription.handle
        with handle:
            for _ in range(DEPTH):
                found = handle.take_message(self._kind, True)
                if found is None:
                    return
                data, information = found
                yield data, information["source_timestamp"] or information["received_timestamp"]

    def close(self) -> None:
        """Close the subscription."""
        self._node.destroy_subscription(self._subscription)
