"""The view beside a run, as a process: it comes and goes, and the run does not mind."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from hybrid_sysid_ros.extensions.view.commands.view import view
from hybrid_sysid_ros.extensions.view.companion import View
from hybrid_sysid_ros.extensions.view.tables import unpacked
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.runtime.session import READY_TIMEOUT
from hybrid_sysid_ros.support.errors import UserError

PATIENCE = 60.0  # s


class Visitor(threading.Thread):
    """Does something with the page of a run, as soon as it is there."""

    def __init__(self, action: Callable[[ClientConnection], None]) -> None:
        super().__init__(daemon=True)
        self.action, self.lines, self.there = action, list[str](), threading.Event()
        self.trouble: BaseException | None = None

    def tell(self, line: str) -> None:
        self.lines.append(line)
        if line.startswith("live view: "):
            self.there.set()

    def run(self) -> None:
        try:
            assert self.there.wait(READY_TIMEOUT)  # all is compiled where no cache is warm
            address = next(line for line in self.lines if line.startswith("live view: ")).removeprefix("live view: ")
            origin: Any = address.partition("/#")[0]
            with connect(address.replace("http://", "ws://").replace("/#", "/live?"), origin=origin) as page:
                self.action(page)
        except BaseException as error:
            self.trouble = error

    def visited(self) -> None:
        self.join(PATIENCE)
        if self.trouble is not None:
            raise self.trouble


@pytest.mark.slow
def test_a_run_is_seen_and_driven_from_its_page(domain: int) -> None:
    rows: dict[str, int] = {}
    nodes: set[str] = set()
    heads: list[Any] = []

    def watch(page: ClientConnection) -> None:
        page.recv(timeout=PATIENCE)
        page.send('{"do": "set_point", "times": [0.0], "values": [[1.0]]}')
        seen: list[float] = []
        while min(rows.get(name, 0) for name in ("measured", "estimate", "command")) < 100 or len(nodes) < 4:
            page.send('{"do": "next"}')
            answer = page.recv(timeout=PATIENCE)
            if isinstance(answer, str):
                assert json.loads(answer)["done"] is not None
                continue
            head, arrays = unpacked(answer)
            heads.append(head)
            for name, count, _ in head["tables"]:
                rows[name] = rows.get(name, 0) + count
            nodes.update(item["node"] for name, item in head["news"].items() if name.startswith("status "))
            seen += arrays["measured"][:, 0].tolist() if "measured" in arrays else []
        steps = [later - sooner for sooner, later in pairwise(seen)]
        assert max(steps) < 0.04  # no answer is missing; a plant that is late leaves a sample or two out

    visitor = Visitor(watch)
    visitor.start()
    outcome = Run(reference="sine", duration=6.0, companions=[View(port=0)], domain=domain, tell=visitor.tell).go()
    visitor.visited()
    assert nodes == {"plant", "estimator", "controller", "reference", "view"}
    assert outcome.diagnostics["view"]["pictures"] == len(heads)
    assert 0.0 < outcome.diagnostics["view"]["cpu_share"] < 0.5  # no message wakes it


@pytest.mark.slow
def test_a_page_stops_a_running_controller_and_records_it(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    inputs: list[float] = []
    states: list[str] = []

    def press(page: ClientConnection) -> None:
        page.recv(timeout=PATIENCE)
        done: dict[int, bool] = {}

        def until(condition: Callable[[], bool]) -> None:
            while not condition():
                page.send('{"do": "next"}')
                answer = page.recv(timeout=PATIENCE)
                if isinstance(answer, str):
                    reported = json.loads(answer)
                    done[reported["answer"]] = reported["done"]
                    continue
                head, arrays = unpacked(answer)
                states.extend(item["state"] for name, item in head["news"].items() if name == "controller")
                inputs.extend(arrays["command"][:, 1].tolist() if "command" in arrays else [])

        until(lambda: len(inputs) > 100 and any(inputs[-20:]))
        page.send('{"do": "record", "on": true, "id": 3}')
        page.send('{"do": "call", "service": "stop", "id": 1}')
        until(lambda: done.get(1, False))
        until(lambda: len(inputs) > 100 and not any(inputs[-100:]))  # at rest, and stays there
        until(lambda: states[-1] == "stopped")
        page.send('{"do": "call", "service": "enable", "id": 2}')
        until(lambda: done.get(2, False) and done.get(3, False))
        until(lambda: all(inputs[-50:]) and states[-1] == "driving")
        page.send('{"do": "record", "on": false, "id": 4}')
        until(lambda: done.get(4, False))

    visitor = Visitor(press)
    visitor.start()
    Run(reference="sine", duration=12.0, companions=[View(port=0)], domain=domain, tell=visitor.tell).go()
    visitor.visited()
    (bag,) = (tmp_path / "recordings").iterdir()
    assert bag.name.startswith("cam_beam_")
    assert (bag / "metadata.yaml").exists()


@pytest.mark.slow
def test_a_run_goes_on_while_its_view_comes_back_to_the_same_page(domain: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    again: list[str] = []

    def kill(page: ClientConnection) -> None:
        greeting = json.loads(page.recv(timeout=PATIENCE))
        os.kill(_listener(port), signal.SIGKILL)
        end = time.monotonic() + PATIENCE
        while not again:
            assert time.monotonic() < end
            try:
                with connect(f"ws://127.0.0.1:{port}{page.request.path}", origin=page.request.headers["Origin"]) as new:
                    again.append(json.loads(new.recv(timeout=PATIENCE))["rig"])
            except (OSError, WebSocketException):
                time.sleep(0.1)
        assert again == [greeting["rig"]]

    visitor = Visitor(kill)
    visitor.start()
    outcome = Run(reference="sine", duration=8.0, companions=[View(port=port)], domain=domain, tell=visitor.tell).go()
    visitor.visited()
    assert not outcome.interrupted
    assert any(line.startswith("view ended") and "started again" in line for line in visitor.lines)
    assert outcome.diagnostics["controller"]


def test_a_port_that_is_taken_is_reported_before_anything_is_shown(domain: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"port {port}.*--port"):
            view(rig="cam_beam", port=port, domain=domain, show=lambda url: None, tell=lambda line: None)


def _listener(port: int) -> int:
    """The process that listens on a port of this computer."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    (inode,) = [row[9] for row in rows if row[1] == f"0100007F:{port:04X}" and row[3] == "0A"]
    for path in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.readlink(path) == f"socket:[{inode}]":
                return int(path.parts[2])
        except OSError:
            continue
    raise AssertionError("nobody listens")
