"""Companion: an extension's part in the loop of a rig, with nodes and changed parameters of other nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from hybrid_sysid_ros.support.errors import UserError

if TYPE_CHECKING:
    from hybrid_sysid_ros.runtime.session import Session

LOOP = ("plant", "estimator", "controller", "reference")
RECORDER = "recorder"

NodeValues = dict[str, dict[str, Any]]
"""Values of parameters by node and name."""


class SharedProcess(NamedTuple):
    """A process that runs several nodes."""

    nodes: Sequence[str]
    command: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class RequestedLoop:
    """The requested loop, which companions join."""

    rig: str
    """Name or path of the rig."""
    reference: str = ""
    """Name of the reference; "": the rig's first."""
    duration: float = 0.0
    """Length of the reference [s]; 0: its own length, or until Ctrl-C."""
    lockstep: bool = False
    recorded: bool = False
    folder: str = ""
    """Folder of files that a user may name while the loop runs; "": none."""
    simulated: bool = True
    """Whether the plant is simulated; else a rig with drivers of its own stands in for it."""
    companions: tuple[str, ...] = ()
    """Names of all companions."""


class Companion:
    """A participant in a loop. Its methods do nothing by default."""

    name: ClassVar[str]
    beside: ClassVar[bool] = False
    """Whether the loop goes on when one of its nodes ends; they are then stopped last, with the recorder."""

    replaces: ClassVar[frozenset[str]] = frozenset()
    """The loop's nodes that don't run, because it does their work."""

    def check(self, loop: RequestedLoop) -> None:
        """Raise UserError where it can't join; called before anything is started."""

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        """Parameters of its nodes, and changed parameters of the loop's nodes. Raises UserError where it has none."""
        return {}

    def nodes(self, loop: RequestedLoop) -> set[str]:
        """Names of the nodes that run only for it."""
        return {*self.parameters(loop)} - {*LOOP, RECORDER}

    def processes(self, session: Session, values: NodeValues) -> Mapping[str, SharedProcess]:
        """Processes that run some of the loop's nodes, by name: it takes the nodes' parameters from ``values``. Raises
        UserError where it can't run them.
        """
        return {}

    def ready(self, said: Callable[[str], set[str]]) -> str:
        """A line for the user once all nodes are ready, or "". said: gives a node's words on its standard output."""
        return ""


def join(loop: RequestedLoop, values: NodeValues, companions: Sequence[Companion]) -> None:
    """Add the nodes of companions to the values of a loop's parameters, and change those that they change.

    Raises UserError where two want different values of one parameter. Values for a recorder count only where one runs.
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
