"""Session: starts the nodes of a rig as processes, waits for their end and stops them, without ROS in this process."""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, Queue
from typing import Any

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import node_commands, processes
from hybrid_sysid_ros.runtime.node_commands import COMPOSED
from hybrid_sysid_ros.runtime.processes import check_ros
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import Report

READY_TIMEOUT = 300.0  # s, until a node has imported and compiled everything
START_TIMEOUT = 30.0  # s, until the loop is complete
STOP_TIMEOUTS = ((signal.SIGINT, 15.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))  # s
STOPPED_FIRST = ("plant", "reference", COMPOSED)
STOPPED_LAST = ("recorder",)
"""Nodes that are stopped last, together with those that are not needed, which may want to see the end."""
REFUSED = 2
"""Status of a node that says in a line what is wrong."""
REPORTED = "reported"
"""Word of a node whose last diagnostics have come."""
TICK = 0.25  # s, between two calls of progress


@dataclass(kw_only=True)
class Child:
    """A node's process, its words on standard output, and the last line of its standard error.

    nodes: that it runs, most often one. again: the command that starts it again when it dies. starts: how often it was
    started.
    """

    node: str
    nodes: Sequence[str]
    process: subprocess.Popen[str]
    again: Sequence[str]
    starts: int = 1
    needed: bool = True
    """Whether a run can't go on without it, once it is ready."""
    listeners: list[threading.Thread] = field(default_factory=list)
    words: set[str] = field(default_factory=set)
    reported: set[str] = field(default_factory=set)
    complaint: str = ""

    def has_ended(self, word: str = "") -> bool:
        """Whether its process has, or it has said a word."""
        return bool(word and word in self.words) or self.process.poll() is not None


class Session:
    """Processes of nodes, as a context that leaves none behind. `tell` receives their log lines."""

    def __init__(self, rig: str, *, domain: int | None = None, respawn: int = 0, tell: Report = print) -> None:
        """rig: name or path. domain: ROS_DOMAIN_ID; by default the environment's. respawn: how often each node is
        started again that was ready once and then died: by a signal or an error that nobody foresaw.

        Raises UserError without ROS for this Python.
        """
        check_ros()
        if domain is not None and not 0 <= domain <= 232:
            raise UserError(f"ROS domain {domain}: it must be within 0 and 232")
        self.rig = rigs.load(rig).source
        self.children: dict[str, Child] = {}
        self.diagnostics: dict[str, dict[str, Any]] = {}
        self._respawn = respawn
        self._tell = tell
        self._namespace = rigs.load(rig).namespace
        self._environment = {**processes.environment(domain), interruption.TETHER: "1"}
        self._place = tempfile.TemporaryDirectory(prefix="hybrid_sysid_")
        self._lines: Queue[tuple[Child, str, str]] = Queue()
        self._stopped = False

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._stopped:
            self.stop()
        self._place.cleanup()

    def command(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Command that starts a node in the rig's namespace; see :func:`.node_commands.command`."""
        return node_commands.command(node, values, rig=self.rig, namespace=self._namespace)

    def composed(self, values: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Command that starts nodes in one process; see :func:`.node_commands.composed`."""
        return node_commands.composed(values, self._file, rig=self.rig, namespace=self._namespace)

    def arguments(self, values: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Arguments of a program that runs several nodes in the namespace; see :func:`.node_commands.arguments`."""
        return node_commands.arguments(values, self._file, rig=self.rig, namespace=self._namespace)

    @property
    def _file(self) -> Path:
        return Path(self._place.name) / "parameters.yaml"

    def start(
        self,
        node: str,
        command: Sequence[str],
        *,
        nodes: Sequence[str] = (),
        needed: bool = True,
        again: Sequence[str] | None = None,
    ) -> None:
        """Start a node's process. nodes: those that it runs, if these are several. needed: whether the session ends
        when it does, also once it was ready. again: the command that starts it again, by default the same.
        """
        process = self._process(command)
        child = Child(node=node, nodes=nodes or (node,), process=process, needed=needed, again=again or command)
        self._stopped = False
        self._adopt(child)

    def _process(self, command: Sequence[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # which closes when this process ends in any way
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=self._environment,
            start_new_session=True,  # Ctrl-C reaches only this process, which stops them in order
        )

    def _adopt(self, child: Child) -> None:
        self.children[child.node] = child
        for stream in ("stdout", "stderr"):
            child.listeners.append(threading.Thread(target=self._listen, args=(child, stream), daemon=True))
            child.listeners[-1].start()

    def wait_for(self, word: str, nodes: Sequence[str], timeout: float) -> None:
        """Wait until each of the nodes has said a word ("ready", "started"). Raises UserError where time is over or
        any node ended, but for one that was ready and has done its work, such as a short reference.
        """
        end = time.monotonic() + timeout
        while waiting := [node for node in nodes if word not in self.children[node].words]:
            self._receive(TICK)
            for child in list(self.children.values()):
                if not self._has_done_its_work(child):
                    self._check(child)
            if time.monotonic() > end:
                raise UserError(f"{', '.join(waiting)} not {word} after {timeout:g} s: is the machine overloaded?")

    def said(self, node: str) -> set[str]:
        """The words of a node on its standard output so far."""
        return self.children[node].words if node in self.children else set()

    def wait_for_end(self, nodes: Sequence[str], progress: Callable[[float], None]) -> None:
        """Wait until one of these nodes has ended without an error; `progress` receives the seconds waited. Raises
        UserError where a node failed or ended too early.
        """
        begin = time.monotonic()
        while True:
            self._receive(TICK)
            progress(time.monotonic() - begin)
            for child in list(self.children.values()):
                if child.node in nodes and child.process.poll() == 0:
                    return
                self._check(child)

    def stop(self) -> dict[str, dict[str, Any]]:
        """Stop all nodes, the plant first and the recorder last; return the last diagnostics of each.

        A node that has reported these does no more: the next ones need not wait until its process has ended, in which
        time a controller would come to rest for want of estimates and count that.
        """
        groups: tuple[list[Child], ...] = [], [], []
        for child in self.children.values():
            last = child.node in STOPPED_LAST or not child.needed
            groups[0 if child.node in STOPPED_FIRST else 2 if last else 1].append(child)
        for running, enough in (*((group, REPORTED) for group in groups), ([*self.children.values()], "")):
            for number, timeout in STOP_TIMEOUTS:
                end = time.monotonic() + timeout
                running = [child for child in running if not child.has_ended(enough)]
                for child in running:
                    if number == signal.SIGKILL:
                        self._tell(f"{child.node} does not end: killed")
                    # Before it is ready, Python itself would print a traceback for an interrupt.
                    child.process.send_signal(number if "ready" in child.words else max(number, signal.SIGTERM))
                while time.monotonic() < end and not all(child.has_ended(enough) for child in running):
                    self._receive(0.02)
        for child in self.children.values():
            self._receive_last(child)
            if child.process.stdin is not None:
                child.process.stdin.close()
        self._stopped = True
        for child in self.children.values():
            for node in child.nodes if child.starts > 1 else ():
                self.diagnostics.setdefault(node, {})["restarts"] = child.starts - 1
        nodes = [node for child in self.children.values() for node in child.nodes]
        return {node: self.diagnostics.get(node, {}) for node in (*nodes, *self.diagnostics)}

    def check_end(self) -> None:
        """Raise UserError for a node that did not end, or failed, such as a recorder that could not write."""
        for child in self.children.values():
            status = child.process.poll()
            if status is None or status > 0 or status == -signal.SIGKILL:
                raise self._failure(child)

    def _has_done_its_work(self, child: Child) -> bool:
        if child.process.poll() != 0:
            return False
        self._receive_last(child)
        return "ready" in child.words

    def _check(self, child: Child) -> None:
        if child.process.poll() is None:
            return
        self._receive_last(child)
        if self._revived(child):
            return
        if child.needed or "ready" not in child.words:
            raise self._failure(child)
        self._tell(f"{self._failure(child)}; the others go on")
        if child.process.stdin is not None:
            child.process.stdin.close()
        del self.children[child.node]

    def _revived(self, child: Child) -> bool:
        """Start a node again that died after it was ready, as often as may be; whether it was. One that ended by itself
        has said why. A controller that was stopped, disarmed or in an emergency stop does not move before it is armed.
        """
        died = child.process.returncode not in (0, REFUSED)
        if not died or child.starts > self._respawn or not (child.starts > 1 or "ready" in child.words):
            return False
        self._tell(f"{self._failure(child)}; started again, {child.starts} of {self._respawn}")
        if child.process.stdin is not None:
            child.process.stdin.close()
        stay = ("-p", "armed:=false") if "at rest" in child.words else ()
        process = self._process([*child.again, *stay])
        self._adopt(
            replace(
                child, process=process, starts=child.starts + 1, listeners=[], words=set(), reported=set(), complaint=""
            )
        )
        return True

    def _failure(self, child: Child) -> UserError:
        status = child.process.poll()
        ended = "does not end" if status is None else f"ended with status {status}"
        said = child.complaint.removeprefix("error: ") or "without a word"
        why = "killed" if status == -signal.SIGKILL else said  # what it said is then no reason
        return UserError(f"{child.node} {ended}: {why}")

    def _listen(self, child: Child, stream: str) -> None:
        with getattr(child.process, stream) as lines:
            for line in lines:
                self._lines.put((child, stream, line.rstrip()))

    def _receive_last(self, child: Child) -> None:
        """Receive the last words of a node that has ended."""
        for listener in child.listeners:
            listener.join(STOP_TIMEOUTS[-1][1])
        self._receive(0.0)

    def _receive(self, timeout: float) -> None:
        """Receive the nodes' words, waiting up to `timeout` [s] for them."""
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
                self.diagnostics[name := said.pop("node")] = said
                child.reported.add(name)
                if len(child.reported) >= len(child.nodes):
                    child.words.add(REPORTED)
        elif stream == "stdout":
            word, why, _ = line.partition(": ")
            if why:
                self._tell(f"{child.node}: {line}")
            child.words.add(word)
            if word == "may move":  # of a controller, after "at rest"
                child.words.discard("at rest")
        elif line:
            child.complaint = line
            if not line.startswith("error: "):  # errors become the session's own error
                self._tell(f"{child.node}: {line}")
