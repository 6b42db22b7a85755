"""The page in a browser, by its pixels."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")
pytest.importorskip("PIL", reason="needs Pillow: install hybrid_sysid_ros[dev]")

from benchmarks import browser
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.requests import CURVE, POINTS, Fault, Request, RequestMenu, SetPointRequest
from hybrid_sysid_ros.extensions.view.server import Server
from hybrid_sysid_ros.extensions.view.tables import Cursor, Tables
from hybrid_sysid_ros.rigs.rig import Rig

pytestmark = pytest.mark.skipif(not browser.found(), reason="needs a Chromium: install it, or name it in BROWSER_PATH")

PERIOD = 0.005  # s
"""Of the measurements."""


@dataclass
class Service:
    """A rig whose output is a sine of 3 V, its estimate 1 V above and its reference at 5 V; its joint swings."""

    rig: Rig
    angle: float = 0.0
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
            "outputs": [{"name": "position", "unit": "V", "tracked": True, "low": output.low, "high": output.high}],
            "inputs": [{"name": "drive", "unit": "V", "low": -10.0, "high": 10.0}],
            "joints": self.drawing.joints,
            "drawing": self.drawing.description(),
            "extent": list(self.drawing.extent()),
            "kinds": self.offered.kinds,
            "faults": self.offered.faults,
            "policies": self.offered.policies,
            "period": PERIOD,
            "seconds": 20.0,
            "curve": CURVE,
            "points": POINTS,
        }

    def collect(self) -> None:
        while (now := self.k * PERIOD) < time.monotonic() - self.began:
            y = 3.0 * math.sin(now)
            self.tables.tables["measured"].add([now, y, 4.0])
            self.tables.tables["estimate"].add([now, y + 1.0, 0.0, self.angle])
            self.tables.tables["command"].add([now, 4.0, 0.9])
            self.tables.tables["asked"].add([now, 5.0])
            self.k += 1
        times = now + np.arange(101) * PERIOD
        self.tables.replace("reference", np.column_stack([times, np.full(101, 5.0)]))
        status = {"node": "controller", "task": "loop", "level": 1, "line": "late", "values": {"policy": "exact"}}
        self.tables.replace("status", status)
        sound = {"node": "plant", "task": "loop", "level": 0, "line": "running", "values": {"brake": "[0.0, 0.0]"}}
        self.tables.replace("another", sound)

    def frame(self, cursor: Cursor) -> bytes:
        return self.tables.frame(cursor)

    async def act(self, request: Request) -> str:
        self.acted.append(request)
        return "done as asked"


@pytest.fixture
def service(rig: Rig) -> Service:
    return Service(rig)


@pytest.fixture
def shown(service: Service) -> Iterator[Callable[..., browser.Browser]]:
    """Open the page of the desk; nothing is left behind, and the page had nothing to complain about."""
    server, opened = Server(service, port=0, pictures=30.0), []
    server.start()

    def show(**options: Any) -> browser.Browser:
        opened.append(browser.Browser(server.url, **options))
        opened[-1].until("document.querySelectorAll('.chart canvas').length == 4 && +fps.textContent > 0")
        return opened[-1]

    yield show
    for one in opened:
        one.close()
    server.close()
    assert not [line for one in opened for line in one.complaints]


def pixels(page: browser.Browser, selector: str, tone: str) -> np.ndarray[Any, Any]:
    """Places (n, 2) of the pixels of an element, from its upper left corner, that have a colour of the style sheet."""
    rectangle = (
        f"(r => [r.left, r.top, r.right, r.bottom])(document.querySelector('{selector}').getBoundingClientRect())"
    )
    left, top, right, bottom = (round(value) for value in page.evaluate(rectangle))
    wanted = page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('--{tone}')").strip()
    colour = [int(wanted[k : k + 2], 16) for k in (1, 3, 5)]
    image = np.asarray(page.picture(), dtype=int)[top:bottom, left:right]
    rows, columns = np.nonzero((np.abs(image - colour) <= 12).all(axis=-1))
    return np.column_stack([columns, rows])


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_lines_are_where_the_numbers_are(dark: bool, shown: Any) -> None:
    page = shown(dark=dark)
    assert page.evaluate("document.documentElement.dataset.theme") == ("dark" if dark else "light")
    time.sleep(1.0)
    over = ".chart.output .u-over"
    measured, estimate, reference = (pixels(page, over, tone) for tone in ("measured", "estimate", "reference"))
    assert min(map(len, (measured, estimate, reference))) > 100
    level = np.median(reference[:, 1])
    assert (np.abs(reference[:, 1] - level) < 3).mean() > 0.9  # 5 V
    highest, lowest = np.percentile(estimate[:, 1], [0.2, 99.8])  # 4 V and -2 V; rows count downwards
    assert (lowest - level) / (highest - level) == pytest.approx(7.0, rel=0.15)
    assert measured[:, 1].max() == pytest.approx(lowest + (lowest - highest) / 6.0, rel=0.1)  # -3 V


def test_the_page_fits_a_laptop_without_scrolling(shown: Any) -> None:
    page = shown(width=1366, height=657)
    size = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    assert page.evaluate(size) == [1366, 657]
    outside = (
        "[...document.querySelectorAll('button, input, .chart, #drawing')]"
        ".map(e => e.getBoundingClientRect()).filter(r => r.right > 1366 || r.bottom > 657 || !r.height).length"
    )
    assert page.evaluate(outside) == 0


def test_the_rig_moves_as_its_joint_does(service: Service, shown: Any) -> None:
    page = shown()
    slopes = []
    for angle in (0.0, 0.2):
        service.angle = angle
        time.sleep(0.5)
        x, y = pixels(page, "#drawing", "moving").T
        slopes.append(-np.polyfit(x, y, 1)[0])  # pixels go down
    assert slopes == pytest.approx([0.0, math.tan(0.2)], abs=0.03)


def test_pictures_go_on_and_show_all_data(shown: Any) -> None:
    """How many there are on a machine that does nothing else, says benchmarks/live_view.py."""
    page = shown()
    time.sleep(3.0)
    assert 3 <= page.evaluate("+fps.textContent") <= 31
    assert page.evaluate("+rate.textContent") == pytest.approx(200, abs=2)


def test_a_curve_is_asked_for_as_it_was_drawn(service: Service, shown: Any) -> None:
    page = shown()
    left, top, right, bottom = page.rectangle(".chart.output .u-over")
    width, height = right - left, bottom - top
    now = left + width * 8.0 / 11.0  # 8 s of the past, 3 s ahead
    step = width / 11.0
    page.drag([(now + step * (0.5 + 0.05 * k), top + height * (0.3 + 0.01 * k)) for k in range(31)])
    page.until("line.textContent == 'done as asked'")
    (asked,) = service.acted
    assert isinstance(asked, SetPointRequest)
    assert asked.times[0] == 0.0
    assert asked.values[0][0] == pytest.approx(5.0, abs=0.1)  # until then as it was
    assert asked.times[-1] == pytest.approx(2.0, abs=0.05)
    drawn = [value for time, (value,) in zip(asked.times, asked.values, strict=True) if time > 0.52]
    assert (np.diff(drawn) < 0.0).all()  # it was drawn downwards


def test_what_is_pressed_is_asked_for(service: Service, shown: Any) -> None:
    page = shown()
    page.click("#faults button[data-name=brake]")
    page.until("line.textContent == 'done as asked'")
    assert service.acted == [Fault(id=1, name="brake", on=True)]
    assert page.evaluate("document.querySelector('#policies [aria-pressed=true]').dataset.name") == "exact"
    assert page.evaluate("health.textContent") == "1 WARN"


def test_a_page_that_is_loaded_anew_shows_the_same(shown: Any) -> None:
    page = shown()
    page.call("Page.reload")
    time.sleep(0.5)
    page.until("document.querySelectorAll('.chart canvas').length == 4 && +fps.textContent > 0")
    time.sleep(0.5)
    x = pixels(page, ".chart.output .u-over", "estimate")[:, 0]
    left, _, right, _ = page.rectangle(".chart.output .u-over")
    assert np.ptp(x) > 0.6 * (right - left)  # the past, too


def test_the_page_names_nothing_from_elsewhere() -> None:
    folder = Path(browser.__file__).parents[1] / "hybrid_sysid_ros" / "view" / "page"
    for path in folder.glob("*.*"):
        if path.name.startswith("uPlot") or path.suffix == ".txt":
            continue
        text = path.read_text(encoding="utf-8")
        assert "eval(" not in text
        assert "innerHTML" not in text
        assert "http" not in text.replace("http://www.w3.org/2000/svg", ""), path
