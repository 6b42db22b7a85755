"""Run: the loop of a rig as processes, from their start to their end."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.bags import markers
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration, preflight, processes
from hybrid_sysid_ros.runtime.companion import LOOP, RECORDER, Companion, NodeValues, RequestedLoop, SharedProcess, join
from hybrid_sysid_ros.runtime.node_commands import COMPOSED
from hybrid_sysid_ros.runtime.references import length_of
from hybrid_sysid_ros.runtime.session import READY_TIMEOUT, START_TIMEOUT, Session
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder
from hybrid_sysid_ros.support.progress import Report

RunProgress = Callable[[float, float], None]


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """The result of a run.

    diagnostics: the last values of each node by key (see /diagnostics), numbers as numbers.
    interrupted: whether it was ended from outside. bag: path of the recording, if any.
    """

    diagnostics: Mapping[str, Mapping[str, Any]]
    interrupted: bool
    bag: Path | None


@dataclass(frozen=True, kw_only=True)
class Run:
    """Plant, estimator, controller and reference of a rig, each in a process, until the reference has ended."""

    rig: str = ""
    """Name or path of the rig; "" for the default one."""
    policy: str = "supervised"
    policy_path: Path | str = ""
    solver: str = "sqp"
    model: Path | str = ""
    rate: float | None = None
    """Rate of measurements [Hz], the rig's by default."""
    duration: float = 0.0
    """Length of the reference [s]; 0: its own length, or until Ctrl-C."""
    lockstep: bool = False
    """Whether it runs in simulated time, as fast as the nodes answer."""
    reference: str = ""
    """A kind, or one of the rig's by name, its first by default."""
    seed: int = 0
    """Random seed of the sensors' noise; 0: that of the rig's file."""
    bag: Path | str | None = None
    """Folder to record all topics into."""
    overwrite: bool = False
    companions: Sequence[Companion] = ()
    """Companions from extensions."""
    domain: int | None = None
    priority: int | None = None
    """Real-time priority of plant, estimator and controller; None: a modest one where the system permits it."""
    composed: bool = False
    """Whether the loop's nodes run in one process."""
    respawn: int = 3
    """How often each node that dies is started again; never in lockstep, where runs repeat."""
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Further parameters by node and name."""
    tell: Report = print
    """Receives lines for the user."""
    progress: RunProgress = lambda seconds, duration: None
    """Receives the seconds since the start, and the expected total (0: unknown)."""

    def go(self) -> RunResult:
        """Start the nodes, wait for their end, and stop them.

        Raises UserError without ROS, and where a companion can't join, the bag can't be written, or a node could not
        start or ended too early; before anything is started UserErrors, a line for each parameter that is wrong and
        each that does not go with another.
        """
        if self.bag is not None:
            check_folder(self.bag, marker=markers(self.bag), replace=self.overwrite)
        for companion in self.companions:
            companion.check(self._loop)
        values = self.values
        preflight.check(self._described, values)
        for node in {node for companion in self.companions for node in companion.replaces}:
            del values[node]
        expected, interrupted = self._expected(values), False
        with (
            interruptible(),
            _naming(self.bag),
            self._session() as session,
        ):
            try:
                shared = {
                    name: one for item in self.companions for name, one in item.processes(session, values).items()
                }
                if self.composed:
                    together = {node: values.pop(node) for node in LOOP if node in values}
                    shared[COMPOSED] = SharedProcess(tuple(together), session.composed(together))
                for name, one in shared.items():
                    session.start(name, one.command, nodes=one.nodes)
                beside = {node for item in self.companions if item.beside for node in item.nodes(self._loop)}
                for node, given in values.items():
                    again = None
                    if node == RECORDER:  # what it has written stays
                        again = session.command(node, {**given, "overwrite": False, "resume": True})
                    session.start(node, session.command(node, given), needed=node not in beside, again=again)
                session.wait_for("ready", [*shared, *values], READY_TIMEOUT)
                for line in filter(None, (companion.ready(session.said) for companion in self.companions)):
                    self.tell(line)
                session.wait_for("started", [COMPOSED if self.composed else "plant"], START_TIMEOUT)
                ending = [COMPOSED] if self.composed else ["reference", "plant"]
                session.wait_for_end(ending, lambda seconds: self.progress(seconds, expected))
            except KeyboardInterrupt:
                interrupted = True
            diagnostics = session.stop()
            session.check_end()
        bag = None if self.bag is None else Path(self.bag)
        return RunResult(diagnostics=diagnostics, interrupted=interrupted, bag=bag)

    def _session(self) -> Session:
        respawn = 0 if self.lockstep else self.respawn
        return Session(self._described.source, domain=self.domain, respawn=respawn, tell=self.tell)

    @property
    def values(self) -> NodeValues:
        """Parameters of the nodes that run. Raises UserError for parameters of other nodes."""
        values = self._of_the_loop()
        if self.bag is not None:
            values[RECORDER] = {"path": str(self.bag), "overwrite": self.overwrite}
        join(self._loop, values, self.companions)
        priority = self.priority
        if priority is None:
            priority = 0 if self.lockstep else processes.permitted_priority()
        for node, given in values.items():
            given["priority"] = processes.priority_of(node, priority)
        for node, more in self.parameters.items():
            if node not in values:
                raise UserError(f"parameters of {node}: no such node runs here: known are {', '.join(values)}")
            values[node].update(more)
        return values

    @cached_property
    def _described(self) -> Rig:
        return rigs.load(self.rig or rigs.default())

    @property
    def _loop(self) -> RequestedLoop:
        return RequestedLoop(
            rig=self._described.source,
            reference=self.reference,
            duration=self.duration,
            lockstep=self.lockstep,
            recorded=self.bag is not None,
            folder=os.getcwd(),
            companions=tuple(companion.name for companion in self.companions),
        )

    @property
    def _lock(self) -> dict[str, Any]:
        return {"lockstep": self.lockstep}

    def _of_the_loop(self) -> NodeValues:
        latency = {"latency": 0.0} if self.lockstep else {}
        rate = configuration.defaults(self._described, "plant")["rate"] if self.rate is None else self.rate
        model = {"model": str(self.model)}
        driven = {"policy": self.policy, "policy_path": str(self.policy_path), "solver": self.solver}
        return {
            "reference": {"kind": self.reference, "duration": self.duration, **self._lock},
            "estimator": {**model, "rate": rate, **self._lock, **latency},
            "controller": {**model, **driven, **self._lock, **latency},
            "plant": {
                "rate": rate,
                **self._lock,
                **({"seed": self.seed} if self.seed else {}),
                "wait_for_readers": 2 if self.bag is None else 3,
            },
        }

    def _expected(self, values: NodeValues) -> float:
        """Expected duration of the run [s]; 0 where it is unknown."""
        if self.lockstep:
            return 0.0
        chosen = values["reference"]["kind"] or self._described.reference
        return values["reference"]["duration"] or length_of(chosen, self._described)


@contextmanager
def _naming(bag: Path | str | None) -> Iterator[None]:
    """Add the place of the recording, if there is one, to errors."""
    if bag is None:
        return (yield)
    before = _number(bag)
    try:
        yield
    except UserError as error:
        if _number(bag) in (None, before) or str(bag) in str(error):
            raise
        raise UserError(f"{error}; the recording is in {bag}") from error


def _number(path: Path | str) -> int | None:
    """The file system's number of a file or folder, which renaming does not change; None where there is none."""
    return os.stat(path).st_ino if os.path.exists(path) else None


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the first signal that ends a loop interrupt it and ignore others, so that no node is left behind."""
    if threading.current_thread() is not threading.main_thread():
        return (yield)

    def interrupt(number: int, frame: object) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {each: signal.getsignal(each) for each in interruption.ending()}
    for each in before:
        signal.signal(each, interrupt)
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
