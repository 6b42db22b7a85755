"""Executors: who calls the callbacks of nodes: the loop, and beside it threads for what may take its time."""

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

SERVICE_PERIOD = 2e-3  # s, at least between two answers to parameter services, however many are asked
LOOK_PERIOD = 0.1  # s, between two looks whether anybody is there still to be served
PRIVATE = (
    *("_context", "_guard", "_is_shutdown", "_sigint_gc", "_tasks", "_tasks_lock"),
    *(f"_take_{kind}" for kind in (*KINDS, "waitable")),
)
"""What Executor uses of rclpy's own that nobody promises."""
TakeEntity = Callable[[Any], Callable[[], Coroutine[Any, Any, None]] | None]
"""Takes what is ready of an entity, and returns what calls back with it."""


class Executor(SingleThreadedExecutor):
    """Calls back at once, in the one thread that spins it, and keeps what it waits for.

    rclpy's own makes a task of each callback and wakes itself twice behind it, for other threads may spin it, too: it
    looks at all that a node has three times for each message. In the four processes of a loop at 200 Hz that was a
    third of their time.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._found: Iterator[tuple[TakeEntity, Any]] = iter(())
        self._wait_set: WaitSet | None = None
        self._changed = False  # what there is to wait for
        self._waiting = Lock()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Call back once, timeout_sec [s] from now at the latest, or whenever something is ready. Raises what is raised
        there, and ExternalShutdownException when the context has ended.
        """
        found = next(self._found, None)
        if found is None:
            self._found = self._find(timeout_sec)
            found = next(self._found, None)
        if found is not None:
            _call(*found)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Call back no more, and let go of all that was waited for."""
        self._found = iter(())
        ended = bool(super().shutdown(timeout_sec))
        with self._waiting:
            self._renew()
        return ended

    def _find(self, timeout_sec: float | None) -> Iterator[tuple[TakeEntity, Any]]:
        """What is to be called back; nothing when the time is over."""
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
            if kind != "timer" or entity.handle.is_timer_ready():  # one that is cancelled is not
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
        # Nodes wake their executor for what they create and destroy, and so does whoever adds or removes one.
        self._changed = any(entity is self._guard for _, entity in ready)
        return [item for item in ready if item[1].callback_group is not None]

    def _renew(self) -> None:
        """Look anew at the next turn what there is to wait for."""
        if self._wait_set is not None:
            self._wait_set.close()
        self._wait_set, self._changed = None, False

    def _take_guard_condition(self, guard: GuardCondition) -> Any:
        with suppress(InvalidHandle), guard.handle:  # not one that is destroyed: rclpy looks so at all others
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
    """Take what is ready of an entity and call back. Raises what is raised there."""
    run = take(entity)
    if run is None:
        return
    with suppress(StopIteration):
        run().send(None)
        raise RuntimeError(f"the callback of {entity} awaits something: a loop waits for nobody")


def _missing() -> list[str]:
    """Private names that rclpy's executors do not have."""
    found = {*dir(SingleThreadedExecutor), *AnyExecutor.__init__.__code__.co_names}
    return [name for name in PRIVATE if name not in found]


Base: Any = Executor if RCLPY_EXECUTOR.usable(_missing()) else SingleThreadedExecutor
"""Of the loop and its services."""


@dataclass(frozen=True, eq=False)
class NodePart:
    """What one of several executors calls of a node: rclpy's own would call guards that wake another one, too."""

    node: Node
    wanted: Callable[[CallbackGroup], bool]

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.node, name)
        if name in (*KINDS.values(), "waitables"):
            return [entity for entity in found if self.wanted(entity.callback_group)]
        return found


class EventLoop(Base):
    """All of some nodes but what goes on aside."""

    def __init__(self, nodes: Sequence[RigNode], services: Sequence[Services] = ()) -> None:
        """services: what the nodes do beside."""
        self._services = services
        super().__init__()
        apart = {group for node in nodes for group in (node.service_group, node.slow_group)}
        self._parts = [NodePart(node, lambda group: group not in apart) for node in nodes]
        self._exchange = nodes[0].exchange
        self._more = False  # messages of the exchange wait
        for node in nodes:
            self.add_node(node)

    def get_nodes(self) -> list[NodePart]:
        return self._parts

    def wake(self) -> None:
        """Look anew what there is to wait for, here and beside: nodes know of one executor."""
        super().wake()
        for item in self._services:
            item.wake()

    def turn(self) -> None:
        """Wait for something to do and do it, with all that follows in this process."""
        self.spin_once(0.0 if self._more else None)
        self._more = self._exchange is not None and self._exchange.deliver()


class Services(Base):
    """What nodes do beside the loop, by groups, each in a thread of its own: no storm of questions and no report holds
    the loop up, and nothing that takes long a stop.

    So are the events of their publishers, which would cost the loop more than its messages, at each of them.
    """

    def __init__(self, nodes: Sequence[RigNode], groups: Sequence[CallbackGroup]) -> None:
        super().__init__()
        self._parts = [NodePart(node, frozenset(groups).__contains__) for node in nodes]

    def get_nodes(self) -> list[NodePart]:
        return self._parts  # not added: a node has one executor, the loop's

    def serve(self) -> None:
        """Answer, one after the other, until the context or this executor ends; what goes wrong is logged, and the next
        one answered.
        """
        nodes = [part.node for part in self._parts]
        while self.context.ok() and not ended(nodes):
            try:
                self.spin_once(timeout_sec=LOOK_PERIOD)
            except (ExternalShutdownException, ShutdownException):
                return
            except InvalidHandle:
                continue  # the loop destroyed what was looked at
            except Exception as error:
                nodes[0].get_logger().error("".join(format_exception(error)))
            sleep(SERVICE_PERIOD)


def ended(nodes: Sequence[RigNode]) -> bool:
    """Whether one of the nodes has nothing more to do: without it the others wait for ever."""
    return any(node.finished.done() for node in nodes)
