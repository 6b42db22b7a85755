"""Companion: what an extension adds to the loop of a rig: nodes, and changes of the parameters of others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.support.errors import UserError

LOOP = ("plant", "estimator", "controller", "reference")
RECORDER = "recorder"

NodeValues = dict[str, dict[str, Any]]
"""Of parameters, by node and name."""


@dataclass(frozen=True, kw_only=True)
class RequestedLoop:
    """The loop that companions join, as it is asked for."""

    rig: str
    """Name or path."""
    reference: str = ""
    """"": the rig's own."""
    duration: float = 0.0
    """Of the reference [s]; 0: its own, or until Ctrl-C."""
    lockstep: bool = False
    recorded: bool = False
    folder: str = ""
    """Of the files that a user may name while it runs; "": none."""
    simulated: bool = True
    """Whether the plant is simulated; else a rig with drivers of its own stands in for it."""
    companions: tuple[str, ...] = ()
    """Names of all that join it."""


class Companion:
    """What joins a loop. A subclass says what differs from nothing."""

    name: ClassVar[str]
    beside: ClassVar[bool] = False
    """Whether the loop goes on when one of its nodes ends; they are then stopped last, with the recorder."""

    def check(self, loop: RequestedLoop) -> None:
        """Raise UserError where it can't join; before anything is started."""

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        """Its nodes, and the values that it changes in those of the loop. Raises UserError where it has none."""
        return {}

    def nodes(self, loop: RequestedLoop) -> set[str]:
        """Names of those nodes that run for its sake alone."""
        return {*self.parameters(loop)} - {*LOOP, RECORDER}

    def ready(self, said: Callable[[str], set[str]]) -> str:
        """A line for the user once all nodes are ready, if any. said: the words of a node on its standard output."""
        return ""


def join(loop: RequestedLoop, values: NodeValues, companions: Sequence[Companion]) -> None:
    """Add the nodes of companions to the values of a loop's parameters, and change those that they change.

    Raises UserError where two want different values of one parameter. What is for a recorder is left where none runs.
    """
    by: dict[tuple[str, str], str] = {}
    for companion in companions:
        for node, given in companion.parameters(loop).items():
            if node == RECORDER and not loop.recorded:
                continue
            own = values.setdefault(node, {})
            for name, value in given.items():
                other = by.setdefault((node, name), companion.name)
                if other != companion.name and own[name] != value:
                    raise UserError(
                        f"{other} and {companion.name} want different values of {name} of the {node}: leave one out"
                    )
                own[name] = value
