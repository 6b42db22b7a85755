"""The native loop as a part of a run: it takes the place of the Python nodes estimator and controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Annotated, ClassVar

import typer

from hybrid_sysid_ros.extensions.native.rig_parameters import AT_START, NODES, UNWATCHED_LOOP, UNWATCHED_SENSORS
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop, SharedProcess
from hybrid_sysid_ros.runtime.configuration import settings
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import Report


@dataclass(frozen=True, kw_only=True)
class Native(Companion):
    """Estimator and controller as one process in C."""

    name: ClassVar[str] = "native"
    tell: Report = print

    def check(self, loop: RequestedLoop) -> None:
        _build().check_tools()

    def processes(self, session: Session, values: NodeValues) -> Mapping[str, SharedProcess]:
        if not {*NODES} <= values.keys():
            raise UserError("--native runs the estimator, which another option (--board) replaces: leave one out")
        rig, given = load(session.rig), {node: values.pop(node) for node in NODES}
        every = {node: settings(rig, node, own)[0] or {} for node, own in given.items()}
        binary = _build().native_loop(rig, every, tell=self.tell)
        started = {node: {name: own[name] for name in own if name in AT_START} for node, own in given.items()}
        return {self.name: SharedProcess(NODES, [str(binary), *session.arguments(started)])}

    def ready(self, said: Callable[[str], set[str]]) -> str:
        return f"the native loop does not watch: {UNWATCHED_SENSORS}; {UNWATCHED_LOOP}"


def _build() -> ModuleType:
    """What builds the loop. Raises UserError without the extension that prints a loop as C."""
    try:
        return import_module("hybrid_sysid_ros.extensions.native.build")
    except ModuleNotFoundError as error:
        raise UserError(f"--native: needs the extension export, which prints a loop as C ({error})") from error


def companion(
    native: Annotated[
        bool, typer.Option("--native", help="Run estimator and controller as one process in C, built when needed.")
    ] = False,
) -> Native | None:
    """The native loop, where it is asked for."""
    return Native() if native else None
