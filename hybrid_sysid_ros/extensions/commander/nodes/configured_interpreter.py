"""Configured interpreter: an interpreter of commands for a running loop, by the parameters that its nodes have now."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from threading import Thread
from typing import Any

from rcl_interfaces.msg import ParameterEvent

from hybrid_sysid_ros.extensions.commander.language.forecast import Simulator
from hybrid_sysid_ros.extensions.commander.language.interpreter import Interpreter
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.parameter_query import ParameterQuery
from hybrid_sysid_ros.support.errors import UserError

ASKED = ("controller", "estimator")  # nodes whose parameters a simulation takes
NICENESS = 10  # of what simulates: it comes after the loop


def give_way() -> None:
    """Let this thread, which inherits the real-time priority of the one that began it, come after all others."""
    with suppress(OSError, AttributeError):  # no Linux
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICENESS)


class ConfiguredInterpreter:
    """Asks controller and estimator what parameters they have, again whenever these change, and makes an interpreter
    that simulates so, in a thread of its own.

    interpreter: None until there is one, and where none can be made.
    """

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self.interpreter: Interpreter | None = None
        self._trouble = ""
        self._known: dict[str, dict[str, Any]] = {}
        space = node.get_namespace().rstrip("/")
        self._names = {f"{space}/{name}" for name in ASKED}
        self._inquiry = ParameterQuery(node, ASKED, self._learn)
        self._events = node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, 100)

    def close(self) -> None:
        """Ask nobody any more."""
        self._inquiry.close()
        self._node.destroy_subscription(self._events)

    @property
    def missing(self) -> str:
        """Why there is no interpreter, in a line."""
        if self._trouble:
            return f"the commander can't simulate the rig: {self._trouble}"
        if unheard := [name for name in ASKED if name not in self._known]:
            return f"no {' and no '.join(unheard)} is there: is the loop running?"
        return "the commander still simulates what the rig reaches: say it again in some seconds"

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node in self._names and len(self._known) == len(ASKED):
            self._known.clear()
            self._inquiry.close()
            self._inquiry = ParameterQuery(self._node, ASKED, self._learn)

    def _learn(self, name: str, values: dict[str, Any]) -> None:
        self._known[name] = values
        if len(self._known) == len(ASKED):
            Thread(target=self._make, args=(dict(self._known),), daemon=True).start()

    def _make(self, known: Mapping[str, Mapping[str, Any]]) -> None:
        """Load, compile, and see what the rig reaches."""
        give_way()
        try:
            simulator = Simulator.configured(self._node.rig, known["controller"], known["estimator"])
            given = self._node.settings
            made = Interpreter.of(simulator, folder=given["folder"], layers=given["layers"])
            _ = simulator.ability  # simulated here, and kept
            with suppress(UserError):  # reported when a picture is named
                _ = made.eyes.reader  # compiled here, and kept
        except Exception as error:
            self.interpreter, self._trouble = None, self._node.words_of(error)
            return
        if self.interpreter is not None:
            made.last = self.interpreter.last
        self.interpreter, self._trouble = made, ""
