"""Executors: who calls the callbacks of nodes: the loop, and beside it threads for what may take its time."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import sleep
from traceback import format_exception
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from hybrid_sysid_ros.nodes.collector import Uncalled

if TYPE_CHECKING:
    from hybrid_sysid_ros.nodes.base import RigNode

SERVICE_PERIOD = 2e-3  # s, at least between two answers to parameter services, however many are asked
LOOK_PERIOD = 0.1  # s, between two looks whether anybody is there still to be served
Take = Callable[[Any], Callable[[], Coroutine[Any, Any, None]] | None]
"""Takes what is ready of an entity, and returns what calls back with it."""


@dataclass(slots=True)
class Call:
    """A callback, as an executor hands it to the thread that spins."""

    entity: Any
    take: Take

    def __call__(self) -> None:
        """Take what is ready and call back. Raises what is raised there."""
        run = self.take(self.entity)
        if run is None:
            return
        with suppress(StopIteration):
            run().send(None)
            raise RuntimeError(f"the callback of {self.entity} awaits something: a loop waits for nobody")

    def exception(self) -> None:
        """None: it was raised."""

    def result(self) -> None:
        """None, as callbacks return."""


class Executor(SingleThreadedExecutor):
    """Calls back at once, in the one thread that spins it.

    rclpy's own makes a task of each callback and wakes itself twice behind it, for other threads may spin it, too: it
    looks at all that a node has three times for each message. In the four processes of a loop at 200 Hz that was a
    third of their time.
    """

    def _make_handler(self, entity: Any, node: Node, take_from_wait_list: Take) -> Any:
        return Call(entity, take_from_wait_list)


class Loop(Executor):
    """All of some nodes but what goes on aside."""

    def __init__(self, nodes: Sequence[RigNode]) -> None:
        super().__init__()
        self._aside = frozenset(group for node in nodes for group in (node.aside, node.patient))
        self._exchange = nodes[0].exchange
        for node in nodes:
            self.add_node(node)

    def can_execute(self, entity: Any) -> bool:
        # One thread spins: of its groups none is ever busy, which asking each of them twice a turn would only cost.
        group = entity.callback_group
        return group not in self._aside and not isinstance(group, Uncalled)

    def turn(self) -> None:
        """Wait for something to do and do it, with all that follows in this process."""
        self.spin_once()
        if self._exchange is not None and self._exchange.deliver():
            self.wake()


class Services(Executor):
    """What nodes do beside the loop, by groups, each in a thread of its own: no storm of questions and no report holds
    the loop up, and nothing that takes long a stop.

    So are the events of their publishers, which would cost the loop more than its messages, at each of them.
    """

    def __init__(self, nodes: Sequence[RigNode], groups: Sequence[CallbackGroup]) -> None:
        super().__init__()
        self._nodes_aside = list(nodes)
        self._aside = frozenset(groups)

    def get_nodes(self) -> list[Node]:
        return list(self._nodes_aside)  # not added: a node has one executor, the loop's

    def can_execute(self, entity: Any) -> bool:
        return entity.callback_group in self._aside

    def serve(self) -> None:
        """Answer, one after the other, until the context or this executor ends; what goes wrong is logged, and the next
        one answered.
        """
        while self.context.ok() and not ended(self._nodes_aside):
            try:
                self.spin_once(timeout_sec=LOOK_PERIOD)
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception as error:
                self._nodes_aside[0].get_logger().error("".join(format_exception(error)))
            sleep(SERVICE_PERIOD)


def ended(nodes: Sequence[RigNode]) -> bool:
    """Whether one of the nodes has nothing more to do: without it the others wait for ever."""
    return any(node.finished.done() for node in nodes)
