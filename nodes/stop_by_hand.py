"""Stop by hand: somebody else than the controller has put the inputs to rest, and they stay there."""

from __future__ import annotations

import math
from dataclasses import replace
from time import perf_counter

from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes.diagnostics import OK, WARN, Task
from hybrid_sysid_ros.nodes.drive import Answers

SERVICE = "controller/stop"
ASK_AGAIN = 1.0  # s, between two calls of it


class StopByHand:
    """Latches until the controller has stopped, too, as its own service then says when it drives again; or, where no
    controller answers that service, until :meth:`release`.
    """

    def __init__(self, node: Node) -> None:
        self.count = self.disobeyed = 0
        """Stops, and commands that were not obeyed because of one."""
        self.latched = False
        self._last_old = math.inf  # number of the newest measurement when the controller had stopped
        self._asked = -math.inf
        self._client = node.create_client(Trigger, SERVICE)

    def release(self) -> None:
        """Let the controller drive again."""
        self.latched, self._last_old = False, math.inf

    def stop(self, answers: Answers) -> None:
        """Latch, and ask the controller to stop; answers: of its commands."""
        self.count += 1
        self.latched = True
        if perf_counter() - self._asked < ASK_AGAIN or not self._client.service_is_ready():
            return

        def stopped(answer: Future) -> None:
            response = answer.result()
            if response is not None and response.success:
                self._last_old = answers.latest

        self._asked = perf_counter()
        self._client.call_async(Trigger.Request()).add_done_callback(stopped)

    def holds(self, answered: int) -> bool:
        """Whether an answer to a measurement is not obeyed; the first one after the controller's stop releases."""
        if self.latched and answered > self._last_old:
            self.release()
        return self.latched

    def noted(self, task: Task) -> Task:
        """The task of the loop, with a word about a stop that lasts."""
        if not self.latched:
            return task
        words = "stopped by hand until the service enable or reset of the plant is called"
        words = words if task.level == OK else f"{task.message}; {words}"
        return replace(task, level=max(task.level, WARN), message=words)
