"""Wait set: the entities for which an executor waits, kept from one turn to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from rclpy.context import Context
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.waitable import NumberOfEntities

KINDS = {  # kinds of entities by the middleware's and the node's names, in the order of their calls
    "timer": "timers",
    "subscription": "subscriptions",
    "guard_condition": "guards",
    "client": "clients",
    "service": "services",
}
ReadyEntities = list[tuple[str, Any]]
"""Ready entities with their kinds; the kind of one that contains several is "waitable"."""


class WaitSet:
    """Entities of nodes. Their handles are held until this closes; entities that are destroyed meanwhile go then.

    rclpy collects and holds the entities and makes a wait set at each turn: 80 us for a node, 240 us for the four of a
    loop in one process, which at 500 Hz is an eighth of the time.
    """

    def __init__(
        self, nodes: Iterable[Node], wanted: Callable[[Any], bool], guards: Sequence[GuardCondition], context: Context
    ) -> None:
        """nodes: nodes with the entities; wanted: which entities to wait for; guards: further guard conditions."""
        nodes = list(nodes)
        with ExitStack() as stack:
            stack.enter_context(context.handle)
            self._entities: dict[str, dict[int, Any]] = {}
            for kind, attribute in KINDS.items():
                entities = [entity for node in nodes for entity in getattr(node, attribute) if wanted(entity)]
                if kind == "guard_condition":
                    entities.extend(guards)
                held = [entity for entity in entities if _hold(stack, entity.handle)]
                self._entities[kind] = {entity.handle.pointer: entity for entity in held}
            waitables = [item for node in nodes for item in node.waitables if wanted(item)]
            self._waitables = [item for item in waitables if _hold(stack, item)]
            size = NumberOfEntities(
                num_subs=len(self._entities["subscription"]),
                num_gcs=len(self._entities["guard_condition"]),
                num_timers=len(self._entities["timer"]),
                num_clients=len(self._entities["client"]),
                num_services=len(self._entities["service"]),
            )
            for item in self._waitables:
                size += item.get_num_entities()
            self._set = rclpy_implementation.WaitSet(
                size.num_subscriptions,
                size.num_guard_conditions,
                size.num_timers,
                size.num_clients,
                size.num_services,
                size.num_events,
                context.handle,
            )
            self._additions = [
                (getattr(self._set, f"add_{kind}"), entity.handle)
                for kind, entities in self._entities.items()
                for entity in entities.values()
            ]
            self._stack = stack.pop_all()

    def wait(self, timeout: int) -> ReadyEntities:
        """Ready entities, after at most ``timeout`` [ns]; below 0 without limit. Raises InvalidHandle if a waitable is
        destroyed.
        """
        self._set.clear_entities()  # the middleware removes entities that are not ready
        for add, handle in self._additions:
            add(handle)
        for item in self._waitables:
            item.add_to_wait_set(self._set)
        self._set.wait(timeout)
        ready: ReadyEntities = [("waitable", item) for item in self._waitables if item.is_ready(self._set)]
        for kind, entities in self._entities.items():
            if entities:
                ready.extend((kind, entities[pointer]) for pointer in self._set.get_ready_entities(kind))
        return ready

    def close(self) -> None:
        """Release all handles."""
        self._stack.close()


def _hold(stack: ExitStack, handle: Any) -> bool:
    """Hold a handle, unless it is destroyed already."""
    with suppress(rclpy_implementation.InvalidHandle):
        stack.enter_context(handle)
        return True
    return False
