"""Exchange: messages between nodes of one process, without the detour through the middleware."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher

AT_ONCE = 16
"""Messages that are delivered before timers and messages from outside have their turn."""
Deliver = Callable[[bytes], None]


class Exchange:
    """Takes serialised messages to those in this process that hear a topic, one after the other, in the loop's thread;
    the middleware takes them to all others.
    """

    def __init__(self) -> None:
        self._hearing: dict[str, list[Deliver]] = defaultdict(list)
        self._outlets: dict[str, int] = defaultdict(int)
        self._waiting: deque[tuple[Deliver, bytes]] = deque()

    def subscribe(self, topic: str, deliver: Deliver) -> None:
        """Hear a topic, by its full name."""
        self._hearing[topic].append(deliver)

    def leave(self, topic: str, deliver: Deliver) -> None:
        """Hear it no longer."""
        self._hearing[topic].remove(deliver)

    def publishers(self, topic: str) -> int:
        """How many of a topic there are here."""
        return self._outlets[topic]

    def listeners(self, topic: str) -> int:
        """How many hear a topic here."""
        return len(self._hearing[topic])

    def opened(self, topic: str, count: int) -> None:
        """So many publishers of a topic more."""
        self._outlets[topic] += count

    def give(self, topic: str, data: bytes) -> None:
        """Leave a message for all here that hear a topic."""
        for deliver in self._hearing[topic]:
            self._waiting.append((deliver, data))

    def deliver(self) -> bool:
        """Deliver what waits, and some of what that leads to; whether something waits still."""
        waiting = self._waiting
        for _ in range(AT_ONCE):
            if not waiting:
                return False
            deliver, data = waiting.popleft()
            deliver(data)
        return bool(waiting)


class Outlet:
    """A publisher whose messages go to both."""

    def __init__(self, publisher: Publisher, exchange: Exchange) -> None:
        self.publisher = publisher
        self._exchange, self._topic = exchange, publisher.topic_name
        exchange.opened(self._topic, 1)

    def publish(self, message: Any) -> None:
        """Publish a serialised message, or one that nobody here hears."""
        if isinstance(message, bytes):
            self._exchange.give(self._topic, message)
        self.publisher.publish(message)

    def get_subscription_count(self) -> int:
        """How many hear it."""
        return int(self.publisher.get_subscription_count()) + self._exchange.listeners(self._topic)

    def close(self) -> None:
        """Publish no longer."""
        self._exchange.opened(self._topic, -1)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.publisher, name)
