"""Exchange: messages between nodes of one process, without the middleware."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher

AT_ONCE = 16
"""Messages that are delivered before timers and messages of other processes are served."""
Deliver = Callable[[bytes], None]


class Exchange:
    """Delivers serialised messages to subscribers in this process, one after the other, in the loop's thread. The
    middleware delivers them to all others.
    """

    def __init__(self) -> None:
        self._hearing: dict[str, list[Deliver]] = defaultdict(list)
        self._outlets: dict[str, int] = defaultdict(int)
        self._waiting: deque[tuple[Deliver, bytes]] = deque()

    def subscribe(self, topic: str, deliver: Deliver) -> None:
        """Subscribe to a topic by its full name."""
        self._hearing[topic].append(deliver)

    def leave(self, topic: str, deliver: Deliver) -> None:
        """Unsubscribe from a topic."""
        self._hearing[topic].remove(deliver)

    def publishers(self, topic: str) -> int:
        """Number of publishers of a topic in this process."""
        return self._outlets[topic]

    def listeners(self, topic: str) -> int:
        """Number of subscribers of a topic in this process."""
        return len(self._hearing[topic])

    def opened(self, topic: str, count: int) -> None:
        """Add ``count`` publishers of a topic."""
        self._outlets[topic] += count

    def give(self, topic: str, data: bytes) -> None:
        """Queue a message for all subscribers of a topic in this process."""
        for deliver in self._hearing[topic]:
            self._waiting.append((deliver, data))

    def deliver(self) -> bool:
        """Deliver queued messages, and some that these cause; whether some are left."""
        waiting = self._waiting
        for _ in range(AT_ONCE):
            if not waiting:
                return False
            deliver, data = waiting.popleft()
            deliver(data)
        return bool(waiting)


class Outlet:
    """A publisher whose messages go to the exchange and to the middleware."""

    def __init__(self, publisher: Publisher, exchange: Exchange) -> None:
        self.publisher = publisher
        self._exchange, self._topic = exchange, publisher.topic_name
        exchange.opened(self._topic, 1)

    def publish(self, message: Any) -> None:
        """Publish a serialised message, or an object that has no subscriber in this process."""
        if isinstance(message, bytes):
            self._exchange.give(self._topic, message)
        self.publisher.publish(message)

    def get_subscription_count(self) -> int:
        """Number of subscribers."""
        return int(self.publisher.get_subscription_count()) + self._exchange.listeners(self._topic)

    def close(self) -> None:
        """Destroy the publisher."""
        self._exchange.opened(self._topic, -1)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.publisher, name)
