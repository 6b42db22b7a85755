"""Parameter query: asks the nodes of a rig for their parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.runtime.parameters import parameters

PERIOD = 0.25  # s, between two checks which nodes are there
PATIENCE = 8  # checks that an answer may take; it is lost where a service does not know its client yet

OnParameters = Callable[[str, dict[str, Any]], None]


class ParameterQuery:
    """Asks each of some nodes, as soon as it is there, for its rig and all its parameters in nodes.yaml, until it has
    answered once.
    """

    def __init__(self, node: RigNode, names: Iterable[str], deliver: OnParameters) -> None:
        """names: nodes in the namespace of `node`. deliver: receives name and parameters of each that answers."""
        self._node, self._deliver = node, deliver
        self._wanted = {name: ["rig", *parameters(node.rig, name)] for name in names}
        self._silent = {name: self._client(name) for name in self._wanted}
        self._asked: dict[str, int] = {}
        """Number of the check at which each node was asked last."""
        self._looks = 0
        self._timer = node.every(PERIOD, self.look)

    def look(self) -> None:
        """Ask the nodes that are there."""
        self._looks += 1
        for name, client in self._silent.items():
            if self._looks - self._asked.get(name, -PATIENCE) >= PATIENCE and client.service_is_ready():
                self._asked[name] = self._looks
                answer = client.call_async(GetParameters.Request(names=self._wanted[name]))
                answer.add_done_callback(partial(self._answered, name))

    def _client(self, name: str) -> Client:
        return self._node.create_client(GetParameters, f"{name}/get_parameters")

    def close(self) -> None:
        """Stop asking."""
        for client in self._silent.values():
            self._node.destroy_client(client)
        self._silent.clear()

    def _answered(self, name: str, answer: Future) -> None:
        values = answer.result().values
        if name not in self._silent:  # this is its second answer
            return
        if len(values) < len(self._wanted[name]):  # it has not declared all yet: ask again
            self._asked.pop(name, None)
            return
        self._node.soon(partial(self._node.destroy_client, self._silent.pop(name)))
        if not self._silent:
            self._timer.cancel()
        self._deliver(name, dict(zip(self._wanted[name], map(parameter_value_to_python, values), strict=True)))
