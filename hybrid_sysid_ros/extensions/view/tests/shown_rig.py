"""Shown rig: what a server serves to a page in a test, without ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.browser import Browser, Chromium
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.requests import CURVE, POINTS, SERVICES, WEIGHTS, Request, RequestMenu
from hybrid_sysid_ros.extensions.view.server import Server
from hybrid_sysid_ros.extensions.view.tables import Cursor, Tables
from hybrid_sysid_ros.rigs.rig import Rig

PERIOD = 0.005  # s
"""Of the measurements."""


@dataclass
class ShownRig:
    """A rig whose output is a sine of 3 V, its estimate 1 V above and its reference at a level; its joint swings."""

    rig: Rig
    angle: float = 0.0
    level: float = 5.0
    state: str = "driving"
    reason: str = ""
    services: tuple[str, ...] = ("stop", "hold", "enable", "reset")
    values: dict[str, str] = field(default_factory=lambda: {"policy": "exact"})
    """Of the controller's status."""
    zero: float = 0.0
    """Of the clock [s]."""
    acted: list[Request] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.offered = RequestMenu.of(self.rig, ("constant", "sine"))
        self.drawing = Drawing(self.rig)
        self.tables = Tables({"measured": 3, "estimate": 4, "command": 3, "asked": 2}, capacity=4000)
        self.began, self.k = time.monotonic() - 10.0, 0
        self.collect()

    def greeting(self) -> dict[str, Any]:
        (output,) = self.offered.outputs
        return {
            "rig": self.rig.name,
            "outputs": [
                {"name": "position", "unit": "V", "tracked": True, "low": output.low, "high": output.high}
                | {"travel": [-10.0, 10.0]}
            ],
            "inputs": [{"name": "drive", "unit": "V", "low": -10.0, "high": 10.0}],
            "joints": self.drawing.joints,
            "drawing": self.drawing.description(),
            "extent": list(self.drawing.extent()),
            "kinds": self.offered.kinds,
            "faults": self.offered.faults,
            "policies": self.offered.policies,
            "services": SERVICES,
            "weights": [{"name": name, "low": 0.0, "high": 1e12, "of": ["position"]} for name in WEIGHTS],
            "period": PERIOD,
            "seconds": 20.0,
            "curve": CURVE,
            "points": POINTS,
        }

    def collect(self) -> None:
        tables = self.tables
        while (now := self.k * PERIOD) < time.monotonic() - self.began:
            t, y = tables.time(round((self.zero + now) * 1e9), leads=True), 3.0 * math.sin(now)
            tables.tables["measured"].add([t, y, 4.0])
            tables.tables["estimate"].add([t, y + 1.0, 0.0, self.angle])
            tables.tables["command"].add([t, 4.0, 0.9])
            tables.tables["asked"].add([t, self.level])
            tables.replace("reference", np.column_stack([t + np.arange(101) * PERIOD, np.full(101, self.level)]))
            self.k += 1
        tables.replace("controller", {"state": self.state, "reason": self.reason})
        nodes = ("plant", "controller", "reference")
        tables.replace("there", {"services": self.services, "nodes": nodes, "set_points": True})
        tables.replace("weights", {"output_weight": [100.0], "rate_weight": [1.0], "input_weight": [0.0]})
        tables.replace("recording", {"on": False, "seconds": 0, "bag": "", "trouble": "", "node": "view_recorder"})
        status = {"node": "controller", "task": "loop", "level": 1, "line": "late", "values": self.values}
        tables.replace("status controller", status)
        sound = {"node": "plant", "task": "loop", "level": 0, "line": "running", "values": {"brake": "[0.0, 0.0]"}}
        tables.replace("status plant", sound)

    def frame(self, cursor: Cursor) -> bytes:
        return self.tables.frame(cursor)

    async def act(self, request: Request) -> str:
        self.acted.append(request)
        return "done as asked"


@contextmanager
def opening(shown_rig: ShownRig, chromium: Chromium) -> Iterator[Callable[..., Browser]]:
    """Serve a rig; what it yields opens the page, with options of the browser. Nothing is left behind, and the page had
    nothing to complain about.
    """
    server, opened = Server(shown_rig, port=0, pictures=30.0), list[Browser]()
    server.start()

    def show(**options: Any) -> Browser:
        opened.append(Browser(server.url, chromium=chromium, **options))
        opened[-1].until("document.querySelectorAll('.chart canvas').length == 5 && +fps.textContent > 0")
        return opened[-1]

    try:
        yield show
    finally:
        for one in opened:
            one.close()
        server.close()
    assert not [line for one in opened for line in one.complaints]
