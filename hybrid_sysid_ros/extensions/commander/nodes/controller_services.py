"""Controller services: by which the commander stops, latches and enables the controller."""

from __future__ import annotations

from threading import Event, get_ident

from rclpy.client import Client
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.support.errors import UserError

ANSWER_TIMEOUT = 2.0  # s


class ControllerServices:
    """Clients of a node for the controller of its loop."""

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self.stopper, self.latcher, self.enabler = (
            node.create_client(Trigger, f"controller/{name}") for name in ("stop", "estop", "enable")
        )

    def call(self, client: Client) -> None:
        """Call a service of the controller and wait for its answer, where another thread hears it. Raises UserError
        where there is no controller, or it refuses.
        """
        if not client.service_is_ready():
            raise UserError(f"no controller is there that answers {client.srv_name}")
        answered = Event()
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda _: answered.set())
        if self._node.thread in (None, get_ident()):
            return  # this thread hears the answer itself, later
        if not answered.wait(ANSWER_TIMEOUT):
            raise UserError(f"the controller does not answer for {ANSWER_TIMEOUT:g} s")
        if not future.result().success:
            raise UserError(f"controller: {future.result().message}")
