"""Collector: messages of a topic that are fetched when it suits the reader, and wake nobody when they come."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

DEPTH = 1000  # messages that wait; older ones are lost


class Uncalled(CallbackGroup):
    """Of what no executor waits for."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class Collector:
    """A subscription of serialised messages, best effort: a publisher waits for no answer of it, and both kinds of
    publishers are heard.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str) -> None:
        """kind: of the messages; topic: its name, for rclpy to resolve."""
        quality = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node, self._kind = node, kind
        self._subscription = node.create_subscription(
            kind, topic, lambda data: None, quality, raw=True, callback_group=Uncalled()
        )

    def fetch(self) -> Iterator[tuple[bytes, int]]:
        """What has come since the last time: each message, and when it was published [ns, system time]."""
        handle = self._subscription.handle
        with handle:
            for _ in range(DEPTH):
                found = handle.take_message(self._kind, True)
                if found is None:
                    return
                data, information = found
                yield data, information["source_timestamp"] or information["received_timestamp"]

    def close(self) -> None:
        """Hear nothing any more."""
        self._node.destroy_subscription(self._subscription)
