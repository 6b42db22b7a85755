"""Session: starts the nodes of a rig as processes, waits for their end and stops them; needs no ROS itself."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Queue
from types import TracebackType
from typing import Any

from hybrid_sysid_ros.bags import markers
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration, processes, sight
from hybrid_sysid_ros.runtime.processes import COMPOSED
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder

READY_TIMEOUT = 300.0  # s, until a node has imported and compiled everything
START_TIMEOUT = 30.0  # s, until the loop is complete
STOP_TIMEOUTS = ((signal.SIGINT, 15.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))  # s
STOP_ORDER = (
    ("plant", "reference", COMPOSED),
    ("estimator", "controller", "camera", "vision"),
    ("recorder", "replay", "view", "commander"),
)
BESIDE = ("view", "commander")
"""Nodes without which a loop goes on."""
LOOP = ("plant", "estimator", "controller", "reference")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # that end a session
TICK = 0.25  # s, between two calls of progress

Tell = Callable[[str], None]
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


@dataclass(kw_only=True)
class Child:
    """A node's process, the words it has said on its standard output, and the last line of its complaints."""

    node: str
    process: subprocess.Popen[str]
    needed: bool = True
    """Whether a run can't go on without it, once it is ready."""
    listeners: list[threading.Thread] = field(default_factory=list)
    words: set[str] = field(default_factory=set)
    complaint: str = ""


def has_ros() -> bool:
    """Whether there is ROS for this Python."""
    return importlib.util.find_spec("rclpy") is not None


def check_ros() -> None:
    """Raises UserError without ROS for this Python, before long work that ends in nodes."""
    if not has_ros():
        raise UserError("no rclpy for this Python: install hybrid_sysid_ros[ros], or source a ROS 2 Jazzy")


class Session:
    """Processes of nodes, as a context that leaves none behind. `tell` gets what they log, line by line."""

    def __init__(self, rig: str, *, domain: int | None = None, tell: Tell = print) -> None:
        """rig: name or path. domain: ROS_DOMAIN_ID; by default the environment's.

        Raises UserError without ROS for this Python.
        """
        check_ros()
        if domain is not None and not 0 <= domain <= 232:
            raise UserError(f"ROS domain {domain}: it must be within 0 and 232")
        self.rig = rigs.load(rig).source
        self.children: dict[str, Child] = {}
        self.diagnostics: dict[str, dict[str, Any]] = {}
        self._tell = tell
        self._namespace = rigs.load(rig).namespace
        self._environment = {**processes.environment(domain), interruption.TETHER: "1"}
        self._place = tempfile.TemporaryDirectory(prefix="hybrid_sysid_")
        self._lines: Queue[tuple[Child, str, str]] = Queue()
        self._stopped = False

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._stopped:
            self.stop()
        self._place.cleanup()

    def command(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Command that starts a node in the rig's namespace; see :func:`.processes.command`."""
        return processes.command(node, values, rig=self.rig, namespace=self._namespace)

    def composed(self, values: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Command that starts nodes in one process; see :func:`.processes.composed`."""
        file = Path(self._place.name) / "parameters.yaml"
        return processes.composed(values, file, rig=self.rig, namespace=self._namespace)

    def start(self, node: str, command: Sequence[str], *, needed: bool = True) -> None:
        """Start a node's process; needed: whether the session ends when it does, also once it was ready."""
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # which ends with this process, however that does
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=self._environment,
            start_new_session=True,  # Ctrl-C comes here, and they are stopped in their order
        )
        self._stopped = False
        child = self.children[node] = Child(node=node, process=process, needed=needed)
        for stream in ("stdout", "stderr"):
            child.listeners.append(threading.Thread(target=self._listen, args=(child, stream), daemon=True))
            child.listeners[-1].start()

    def wait_for(self, word: str, nodes: Sequence[str], timeout: float) -> None:
        """Wait until each of the nodes has said a word ("ready", "started"). Raises UserError where one of all the
        nodes ended, or the time is over.
        """
        end = time.monotonic() + timeout
        while waiting := [node for node in nodes if word not in self.children[node].words]:
            self._hear(TICK)
            for child in list(self.children.values()):
                self._check(child)
            if time.monotonic() > end:
                raise UserError(f"{', '.join(waiting)} not {word} after {timeout:g} s: is the machine overloaded?")

    @property
    def url(self) -> str:
        """Where the page of the node view is, once that is ready."""
        return next((word for word in self.children["view"].words if word.startswith("http://")), "")

    def wait_for_end(self, nodes: Sequence[str], progress: Callable[[float], None]) -> None:
        """Wait until one of these nodes has ended well; `progress` gets the seconds waited. Raises UserError where a
        node ended that should not, or did not end well.
        """
        begin = time.monotonic()
        while True:
            self._hear(TICK)
            progress(time.monotonic() - begin)
            for child in list(self.children.values()):
                if child.node in nodes and child.process.poll() == 0:
                    return
                self._check(child)

    def stop(self) -> dict[str, dict[str, Any]]:
        """Stop all nodes, the plant first and the recorder last; return the last diagnostics of each."""
        for group in STOP_ORDER:
            running = [self.children[node] for node in group if node in self.children]
            for number, timeout in STOP_TIMEOUTS:
                end = time.monotonic() + timeout
                running = [child for child in running if child.process.poll() is None]
                for child in running:
                    if number == signal.SIGKILL:
                        self._tell(f"{child.node} does not end: killed")
                    # Before it is ready, Python itself would complain about an interrupt.
                    child.process.send_signal(number if "ready" in child.words else max(number, signal.SIGTERM))
                while time.monotonic() < end and any(child.process.poll() is None for child in running):
                    self._hear(0.02)
        for child in self.children.values():
            self._hear_last(child)
            if child.process.stdin is not None:
                child.process.stdin.close()
        self._stopped = True
        return {
            node: self.diagnostics.get(node, {}) for node in (*self.children, *self.diagnostics) if node != COMPOSED
        }

    def check_end(self) -> None:
        """Raise UserError for a node that told of a failure, as a recorder that could not write, or did not end."""
        for child in self.children.values():
            status = child.process.poll()
            if status is None or status > 0 or status == -signal.SIGKILL:
                raise self._failure(child)

    def _check(self, child: Child) -> None:
        if child.process.poll() is None:
            return
        self._hear_last(child)
        if child.needed or "ready" not in child.words:
            raise self._failure(child)
        self._tell(f"{self._failure(child)}; the others go on")
        if child.process.stdin is not None:
            child.process.stdin.close()
        del self.children[child.node]

    def _failure(self, child: Child) -> UserError:
        status = child.process.poll()
        ended = "does not end" if status is None else f"ended with status {status}"
        why = child.complaint.removeprefix("error: ") or ("killed" if status == -signal.SIGKILL else "without a word")
        return UserError(f"{child.node} {ended}: {why}")

    def _listen(self, child: Child, stream: str) -> None:
        with getattr(child.process, stream) as lines:
            for line in lines:
                self._lines.put((child, stream, line.rstrip()))

    def _hear_last(self, child: Child) -> None:
        """Take in the last words of a node that has ended."""
        for listener in child.listeners:
            listener.join(STOP_TIMEOUTS[-1][1])
        self._hear(0.0)

    def _hear(self, timeout: float) -> None:
        """Take in what the nodes say, for `timeout` [s] if they say nothing."""
        try:
            entry = self._lines.get(timeout=timeout) if timeout else self._lines.get_nowait()
            while True:
                self._take(*entry)
                entry = self._lines.get_nowait()
        except Empty:
            return

    def _take(self, child: Child, stream: str, line: str) -> None:
        if stream == "stdout" and line.startswith("{"):
            with suppress(ValueError, KeyError):  # cut short, where the node was killed
                said = json.loads(line)
                self.diagnostics[said.pop("node")] = said
        elif stream == "stdout":
            child.words.add(line)
        elif line:
            child.complaint = line
            if not line.startswith("error: "):  # that one becomes the session's own error
                self._tell(f"{child.node}: {line}")


def run(
    *,
    rig: str = "",
    policy: str = "supervised",
    policy_path: Path | str = "",
    solver: str = "sqp",
    model: Path | str = "",
    rate: float | None = None,
    duration: float = 0.0,
    lockstep: bool = False,
    reference: str = "",
    bag: Path | str | None = None,
    overwrite: bool = False,
    view: int | None = None,
    commander: bool = False,
    camera: bool = False,
    layers: Path | str = "",
    picture: Path | str = "",
    domain: int | None = None,
    priority: int | None = None,
    composed: bool = False,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    tell: Tell = print,
    progress: Progress = lambda seconds, duration: None,
) -> Outcome:
    """Run plant, estimator, controller and reference of a rig, each in a process, until the reference has ended.

    rig: name or path, the default one by default. rate: of measurements [Hz], the rig's by default. reference: a kind,
    or one of the rig's by name, its first by default. duration: of the reference [s]; 0: its own, or until Ctrl-C.
    lockstep: as fast as the nodes are, in simulated time. bag: folder to record all topics into. view: port of a page
    that shows the run (0: any); it then goes on when a reference of the rig's own has ended. commander: whether the
    run takes commands in plain language, armed; it then begins at rest and goes on, where no reference is asked for.
    camera: whether a camera takes the sensors' place; a bag then has the simulated rig's true motion, too. layers: by
    which pictures are read, the shipped ones by default. picture: that the exact MPC makes the rig look like.
    priority: of plant, estimator and controller as real-time processes; None: a modest one where the system permits it.
    composed: those of the loop in one process. parameters: more of them, by node and name. tell: gets lines for the
    user. progress: gets the seconds since the start, and how many there will be (0: unknown).

    Raises UserError without ROS, and where a parameter is wrong, the bag can't be written, or a node could not start or
    ended too early.
    """
    described = rigs.load(rig or rigs.default())
    if picture and commander:
        raise UserError("a picture is the goal, or commands say it: leave one out, and say 'look like PICTURE'")
    if bag is not None:
        check_folder(bag, marker=markers(bag), replace=overwrite)
    lock, latency = {"lockstep": lockstep}, {"latency": 0.0} if lockstep else {}
    rate = configuration.defaults(described, "plant")["rate"] if rate is None else rate
    driven = {"policy": policy, "policy_path": str(policy_path), "solver": solver}
    values: dict[str, dict[str, Any]] = {
        "reference": {"kind": reference, "duration": duration, **lock},
        "estimator": {"model": str(model), "rate": rate, **lock, **latency},
        "controller": {"model": str(model), **driven, **lock, **latency},
        "plant": {"rate": rate, **lock, "wait_for_readers": 2 if bag is None else 3},
    }
    values |= {} if bag is None else {"recorder": {"path": str(bag), "overwrite": overwrite}}
    if view is not None:
        values["view"] = {"port": view}
    if commander:
        values["commander"] = {"armed": True, "folder": os.getcwd(), "layers": str(layers)}
        values["reference"] |= {} if reference else {"kind": "constant", "amplitude": 0.0}
    if picture:
        values["controller"] |= {"picture": str(Path(picture).absolute()), "layers": str(layers), "policy": "exact"}
        values["reference"] |= {} if reference else {"kind": "constant", "amplitude": 0.0}
    if view is not None or commander:
        values["reference"]["stay"] = not duration
    if camera:
        for node, seeing in sight.parameters(described, layers).items():
            values[node] = {**lock, **values.get(node, {}), **seeing}
        if bag is not None:
            values["recorder"]["further"] = "motion"
    chosen = processes.permitted_priority() if priority is None and not lockstep else priority or 0
    for node in values:
        values[node]["priority"] = processes.priority_of(node, chosen)
    for node, more in (parameters or {}).items():
        if node not in values:
            raise UserError(f"parameters of {node}: no such node runs here: known are {', '.join(values)}")
        values[node].update(more)
    schedule = described.references.get(values["reference"]["kind"] or described.reference)
    own = schedule.duration if schedule else 0.0
    expected = 0.0 if lockstep else values["reference"]["duration"] or own
    interrupted = False
    with _interruptible(), _naming(bag), Session(described.source, domain=domain, tell=tell) as session:
        try:
            together = {node: values.pop(node) for node in LOOP} if composed else {}
            commands = {COMPOSED: session.composed(together)} if composed else {}
            commands |= {node: session.command(node, given) for node, given in values.items()}
            for child, command in commands.items():
                session.start(child, command, needed=child not in BESIDE)
            session.wait_for("ready", list(commands), READY_TIMEOUT)
            if view is not None:
                tell(f"live view: {session.url}")
            session.wait_for("started", [COMPOSED if composed else "plant"], START_TIMEOUT)
            ending = [COMPOSED] if composed else ["reference", "plant"]
            session.wait_for_end(ending, lambda seconds: progress(seconds, expected))
        except KeyboardInterrupt:
            interrupted = True
        diagnostics = session.stop()
        session.check_end()
    return Outcome(diagnostics=diagnostics, interrupted=interrupted, bag=None if bag is None else Path(bag))


def view(*, rig: str, port: int, show: Callable[[str], None], domain: int | None = None, tell: Tell = print) -> None:
    """Show a rig that others run on a page, until an interrupt. show: gets the page's address. Raises UserError without
    ROS, where the port is taken, and where the view ended early.
    """
    with _interruptible(), Session(rig, domain=domain, tell=tell) as session:
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
def _interruptible() -> Iterator[None]:
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
