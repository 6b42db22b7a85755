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
from hybrid_sysid_ros.nodes.process import announce

SERVICE = "controller/estop"
WORDS = "stopped by hand until the service enable or reset of the plant is called"
ASK_AGAIN = 1.0  # s, between two calls of it


class StopByHand:
    """Latches until the controller has stopped, too, for its own services then say when it drives again; or, where no
    controller answers, until :meth:`release`.
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
        if not self.latched:
            announce(f"stopped: {WORDS}")
        self.latched, self._last_old = True, math.inf
        self._ask(answers)

    def _ask(self, answers: Answers) -> None:
        """Ask the controller, unless it was asked a moment ago or does not answer."""

        def stopped(answer: Future) -> None:
            response = answer.result()
            if response is not None and response.success:
                self._last_old = answers.latest

        if perf_counter() - self._asked > ASK_AGAIN and self._client.service_is_ready():
            self._asked = perf_counter()
            self._client.call_async(Trigger.Request()).add_done_callback(stopped)

    def holds(self, answers: Answers) -> bool:
        """Whether the newest answer is not obeyed; the first one after the controller's stop releases."""
        if self.latched and answers.answered > self._last_old:
            self.release()
        elif self.latched and math.isinf(self._last_old):
            self._ask(answers)
        return self.latched

    def noted(self, task: Task) -> Task:
        """The task of the loop, with a word about a stop that lasts."""
        if not self.latched:
            return task
        words = WORDS if task.level == OK else f"{task.message}; {WORDS}"
        return replace(task, level=max(task.level, WARN), message=words)
