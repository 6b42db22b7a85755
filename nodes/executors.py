"""Executors of the nodes' callbacks: the loop, and threads beside it for slow callbacks."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from time import monotonic, sleep
from traceback import format_exception
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor as AnyExecutor
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.task import Task

from hybrid_sysid_ros.nodes.wait_set import KINDS, ReadyEntities, WaitSet
from hybrid_sysid_ros.support.versions import RCLPY_EXECUTOR

if TYPE_CHECKING:
    from hybrid_sysid_ros.nodes.base import RigNode

SERVICE_PERIOD = 2e-3  # s, least time between two answers to parameter services
LOOK_PERIOD = 0.1  # s, between two checks whether there is something to serve
PRIVATE = (
    *("_context", "_guard", "_is_shutdown", "_sigint_gc", "_tasks", "_tasks_lock"),
    *(f"_take_{kind}" for kind in (*KINDS, "waitable")),
)
"""Private names of rclpy that Executor uses."""
TakeEntity = Callable[[Any], Callable[[], Coroutine[Any, Any, None]] | None]
"""Takes a ready message or event of an entity, and returns the coroutine function of its callback."""


class Executor(SingleThreadedExecutor):
    """Calls callbacks directly, in the one thread that spins it, and keeps its wait set.

    rclpy's executor makes a task of each callback and wakes itself twice after it, since other threads may spin it too.
    So it examines all entities of a node three times for each message: a third of the processor time of a loop's four
    processes at 200 Hz.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._found: Iterator[tuple[TakeEntity, Any]] = iter(())
        self._wait_set: WaitSet | None = None
        self._changed = False  # whether the entities have changed
        self._waiting = Lock()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Call one callback when something is ready, waiting up to timeout_sec [s], or without limit. Raises errors of
        the callback, and ExternalShutdownException when the context has ended.
        """
        found = next(self._found, None)
        if found is None:
            self._found = self._find(timeout_sec)
            found = next(self._found, None)
        if found is not None:
            _call(*found)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop calling callbacks, and release the wait set."""
        self._found = iter(())
        ended = bool(super().shutdown(timeout_sec))
        with self._waiting:
            self._renew()
        return ended

    def _find(self, timeout_sec: float | None) -> Iterator[tuple[TakeEntity, Any]]:
        """Ready entities; none when the time is over."""
        end = None if timeout_sec is None or timeout_sec < 0.0 else monotonic() + timeout_sec
        with self._tasks_lock:
            tasks: list[Task] = [task for task, _, _ in self._tasks]
            self._tasks.clear()
        for task in tasks:
            yield self._run, task
        ready: ReadyEntities = []
        while not ready and not self._is_shutdown:
            left = -1 if end is None else max(0, round(1e9 * (end - monotonic())))
            with self._waiting:
                ready = self._wait(left)
            if not self._context.ok() and not self._is_shutdown:
                raise ExternalShutdownException
            if left == 0:
                break
        for kind, entity in ready:
            if kind != "timer" or entity.handle.is_timer_ready():  # a cancelled timer is not ready
                yield getattr(self, f"_take_{kind}"), entity

    def _wait(self, timeout: int) -> ReadyEntities:
        if self._changed:
            self._renew()
        if self._is_shutdown:
            return []
        if self._wait_set is None:
            guards = (self._guard, self._sigint_gc)
            self._wait_set = WaitSet(self.get_nodes(), self.can_execute, guards, self._context)
        try:
            ready = self._wait_set.wait(timeout)
        except InvalidHandle:
            self._changed = True
            return []
        # Nodes wake their executor when they create or destroy entities, as does adding or removing a node.
        self._changed = any(entity is self._guard for _, entity in ready)
        return [item for item in ready if item[1].callback_group is not None]

    def _renew(self) -> None:
        """Rebuild the wait set at the next turn."""
        if self._wait_set is not None:
            self._wait_set.close()
        self._wait_set, self._changed = None, False

    def _take_guard_condition(self, guard: GuardCondition) -> Any:
        with suppress(InvalidHandle), guard.handle:  # unless it is destroyed, as rclpy checks for all others
            return super()._take_guard_condition(guard)
        return None

    def _run(self, task: Task) -> None:
        task()
        if not task.done():
            with self._tasks_lock:
                self._tasks.append((task, None, None))
        elif (error := task.exception()) is not None:
            raise error


def _call(take: TakeEntity, entity: Any) -> None:
    """Take the ready message or event of an entity and call its callback. Raises errors of the callback."""
    run = take(entity)
    if run is None:
        return
    with suppress(StopIteration):
        run().send(None)
        raise RuntimeError(f"the callback of {entity} awaits something, which the loop does not support")


def _missing() -> list[str]:
    """Private names that rclpy's executors do not have."""
    found = {*dir(SingleThreadedExecutor), *AnyExecutor.__init__.__code__.co_names}
    return [name for name in PRIVATE if name not in found]


Base: Any = Executor if RCLPY_EXECUTOR.usable(_missing()) else SingleThreadedExecutor
"""Base of the loop and its services."""


@dataclass(frozen=True, eq=False)
class NodePart:
    """The callback groups of a node that one of several executors serves. rclpy's would also serve guards of others."""

    node: Node
    wanted: Callable[[CallbackGroup], bool]

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.node, name)
        if name in (*KINDS.values(), "waitables"):
            return [entity for entity in found if self.wanted(entity.callback_group)]
        return found


class EventLoop(Base):
    """The executor of some nodes without their services."""

    def __init__(self, nodes: Sequence[RigNode], services: Sequence[Services] = ()) -> None:
        """services: executors of the nodes' services."""
        self._services = services
        super().__init__()
        apart = {group for node in nodes for group in (node.service_group, node.slow_group)}
        self._parts = [NodePart(node, lambda group: group not in apart) for node in nodes]
        self._exchange = nodes[0].exchange
        self._more = False  # whether messages of the exchange wait
        for node in nodes:
            self.add_node(node)

    def get_nodes(self) -> list[NodePart]:
        return self._parts

    def wake(self) -> None:
        """Rebuild the wait sets of the loop and its services, since nodes know only one executor."""
        super().wake()
        for item in self._services:
            item.wake()

    def turn(self) -> None:
        """Wait for an event and handle it, with all messages that follow in this process."""
        self.spin_once(0.0 if self._more else None)
        self._more = self._exchange is not None and self._exchange.deliver()


class Services(Base):
    """Services of nodes beside the loop, by callback group, each in a thread of its own: requests and reports do not
    delay the loop, and slow ones do not delay a stop.

    They also handle the events of publishers, which would cost the loop more than its messages.
    """

    def __init__(self, nodes: Sequence[RigNode], groups: Sequence[CallbackGroup]) -> None:
        super().__init__()
        self._parts = [NodePart(node, frozenset(groups).__contains__) for node in nodes]

    def get_nodes(self) -> list[NodePart]:
        return self._parts  # these are not added: a node has one executor, the loop's

    def serve(self) -> None:
        """Answer requests one after the other until the context or this executor ends; errors are logged."""
        nodes = [part.node for part in self._parts]
        while self.context.ok() and not ended(nodes):
            try:
                self.spin_once(timeout_sec=LOOK_PERIOD)
            except (ExternalShutdownException, ShutdownException):
                return
            except InvalidHandle:
                continue  # the loop destroyed an entity of the wait set
            except Exception as error:
                nodes[0].get_logger().error("".join(format_exception(error)))
            sleep(SERVICE_PERIOD)


def ended(nodes: Sequence[RigNode]) -> bool:
    """Whether one of the nodes has finished: the others would wait for it for ever."""
    return any(node.finished.done() for node in nodes)
