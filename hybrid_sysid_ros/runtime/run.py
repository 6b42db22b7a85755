"""Run: the loop of a rig as processes, from their start to their end, and what it was asked to be."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.bags import markers
from hybrid_sysid_ros.extensions.vision import camera_loop as sight
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration, processes
from hybrid_sysid_ros.runtime.processes import COMPOSED
from hybrid_sysid_ros.runtime.session import READY_TIMEOUT, START_TIMEOUT, Session, Tell
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder

BESIDE = ("view", "commander")
"""Nodes without which a loop goes on."""
LOOP = ("plant", "estimator", "controller", "reference")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # that end a run

Values = dict[str, dict[str, Any]]
"""Of parameters, by node and name."""
Progress = Callable[[float, float], None]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run went.

    diagnostics: the last values of each node by key (see /diagnostics), numbers as numbers.
    interrupted: it was ended from outside. bag: what was recorded, if anything.
    """

    diagnostics: Mapping[str, Mapping[str, Any]]
    interrupted: bool
    bag: Path | None


@dataclass(frozen=True, kw_only=True)
class Run:
    """Plant, estimator, controller and reference of a rig, each in a process, until the reference has ended."""

    rig: str = ""
    """Name or path, the default one by default."""
    policy: str = "supervised"
    policy_path: Path | str = ""
    solver: str = "sqp"
    model: Path | str = ""
    rate: float | None = None
    """Of measurements [Hz], the rig's by default."""
    duration: float = 0.0
    """Of the reference [s]; 0: its own, or until Ctrl-C."""
    lockstep: bool = False
    """As fast as the nodes are, in simulated time."""
    reference: str = ""
    """A kind, or one of the rig's by name, its first by default."""
    bag: Path | str | None = None
    """Folder to record all topics into."""
    overwrite: bool = False
    view: int | None = None
    """Port of a page that shows the run (0: any); it then goes on when a reference of the rig's own has ended."""
    commander: bool = False
    """Whether it takes commands in plain language, armed; it then begins at rest and goes on, where no reference is
    asked for.
    """
    camera: bool = False
    """Whether a camera takes the sensors' place; a bag then has the simulated rig's true motion, too."""
    layers: Path | str = ""
    """By which pictures are read, the shipped ones by default."""
    picture: Path | str = ""
    """That the exact MPC makes the rig look like."""
    domain: int | None = None
    priority: int | None = None
    """Of plant, estimator and controller as real-time processes; None: a modest one where the system permits it."""
    composed: bool = False
    """Those of the loop in one process."""
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """More of them, by node and name."""
    tell: Tell = print
    """Gets lines for the user."""
    progress: Progress = lambda seconds, duration: None
    """Gets the seconds since the start, and how many there will be (0: unknown)."""

    def go(self) -> Outcome:
        """Start the nodes, wait for their end, and stop them.

        Raises UserError without ROS, and where a parameter is wrong, the picture shows no goal, the bag can't be
        written, or a node could not start or ended too early.
        """
        if self.picture and self.commander:
            raise UserError("a picture is the goal, or commands say it: leave one out, and say 'look like PICTURE'")
        if self.bag is not None:
            check_folder(self.bag, marker=markers(self.bag), replace=self.overwrite)
        if self.picture:
            from hybrid_sysid_ros.extensions.vision.goal.goal_picture import (  # late: it loads scipy's optimisers
                reader_of,
                shown_in,
            )

            shown_in(Path(self.picture), reader_of(self._described, self.layers))
        values = self.values
        expected, interrupted = self._expected(values), False
        with (
            interruptible(),
            _naming(self.bag),
            Session(self._described.source, domain=self.domain, tell=self.tell) as session,
        ):
            try:
                together = {node: values.pop(node) for node in LOOP} if self.composed else {}
                commands = {COMPOSED: session.composed(together)} if self.composed else {}
                commands |= {node: session.command(node, given) for node, given in values.items()}
                for child, command in commands.items():
                    session.start(child, command, needed=child not in BESIDE)
                session.wait_for("ready", list(commands), READY_TIMEOUT)
                if self.view is not None:
                    self.tell(f"live view: {session.url}")
                session.wait_for("started", [COMPOSED if self.composed else "plant"], START_TIMEOUT)
                ending = [COMPOSED] if self.composed else ["reference", "plant"]
                session.wait_for_end(ending, lambda seconds: self.progress(seconds, expected))
            except KeyboardInterrupt:
                interrupted = True
            diagnostics = session.stop()
            session.check_end()
        bag = None if self.bag is None else Path(self.bag)
        return Outcome(diagnostics=diagnostics, interrupted=interrupted, bag=bag)

    @property
    def values(self) -> Values:
        """Parameters of the nodes that run. Raises UserError for those of a node that does not."""
        values = self._of_the_loop()
        self._add_those_beside(values)
        if self.camera:
            self._add_eyes(values)
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
    def _lock(self) -> dict[str, Any]:
        return {"lockstep": self.lockstep}

    def _of_the_loop(self) -> Values:
        latency = {"latency": 0.0} if self.lockstep else {}
        rate = configuration.defaults(self._described, "plant")["rate"] if self.rate is None else self.rate
        model = {"model": str(self.model)}
        driven = {"policy": self.policy, "policy_path": str(self.policy_path), "solver": self.solver}
        return {
            "reference": {"kind": self.reference, "duration": self.duration, **self._lock},
            "estimator": {**model, "rate": rate, **self._lock, **latency},
            "controller": {**model, **driven, **self._lock, **latency},
            "plant": {"rate": rate, **self._lock, "wait_for_readers": 2 if self.bag is None else 3},
        }

    def _add_those_beside(self, values: Values) -> None:
        """Recorder, view, commander and a picture as the goal, with what they ask of the reference."""
        layers, wanted = str(self.layers), values["reference"]
        if self.bag is not None:
            values["recorder"] = {"path": str(self.bag), "overwrite": self.overwrite}
        if self.view is not None:
            values["view"] = {"port": self.view}
        if self.commander:
            values["commander"] = {"armed": True, "folder": os.getcwd(), "layers": layers}
        if self.picture:
            picture = str(Path(self.picture).absolute())
            values["controller"] |= {"picture": picture, "layers": layers, "policy": "exact"}
        if (self.commander or self.picture) and not self.reference:
            wanted |= {"kind": "constant", "amplitude": 0.0}
        if self.view is not None or self.commander:
            wanted["stay"] = not self.duration

    def _add_eyes(self, values: Values) -> None:
        for node, seeing in sight.parameters(self._described, self.layers).items():
            values[node] = {**self._lock, **values.get(node, {}), **seeing}
        if self.bag is not None:
            values["recorder"]["further"] = "motion"

    def _expected(self, values: Values) -> float:
        """How long it takes [s]; 0 where nobody knows."""
        schedule = self._described.references.get(values["reference"]["kind"] or self._described.reference)
        own = schedule.duration if schedule else 0.0
        return 0.0 if self.lockstep else values["reference"]["duration"] or own


def view(*, rig: str, port: int, show: Callable[[str], None], domain: int | None = None, tell: Tell = print) -> None:
    """Show a rig that others run on a page, until an interrupt. show: gets the page's address. Raises UserError without
    ROS, where the port is taken, and where the view ended early.
    """
    with interruptible(), Session(rig, domain=domain, tell=tell) as session:
        with suppress(KeyboardInterrupt):
            priority = processes.priority_of("view", processes.permitted_priority())
            session.start("view", session.command("view", {"port": port, "priority": priority}))
            session.wait_for("ready", ["view"], READY_TIMEOUT)
            show(session.url)
            session.wait_for_end(["view"], lambda seconds: None)
        session.stop()
        session.check_end()


@contextmanager
def _naming(bag: Path | str | None) -> Iterator[None]:
    """Let an error say where the recording is, if there is one."""
    if bag is None:
        return (yield)
    before = _number(bag)
    try:
        yield
    except UserError as error:
        if _number(bag) in (None, before) or str(bag) in str(error):
            raise
        raise UserError(f"{error}; what was recorded is in {bag}") from error


def _number(path: Path | str) -> int | None:
    """By which the file system knows a file or folder, whatever is renamed; None where there is none."""
    return os.stat(path).st_ino if os.path.exists(path) else None


@contextmanager
def interruptible() -> Iterator[None]:
    """Any of the SIGNALS interrupts once; further ones do nothing, so that no node is left behind."""
    if threading.current_thread() is not threading.main_thread():
        return (yield)

    def interrupt(number: int, frame: object) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {each: signal.getsignal(each) for each in SIGNALS}
    for each in before:
        signal.signal(each, interrupt)
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
