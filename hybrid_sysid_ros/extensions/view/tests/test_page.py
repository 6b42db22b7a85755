"""The page in a browser, by its pixels."""

from __future__ import annotations

import math
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")
pytest.importorskip("PIL", reason="needs Pillow: install hybrid_sysid_ros[dev]")

from benchmarks import browser
from hybrid_sysid_ros.extensions.view.page_token import folder
from hybrid_sysid_ros.extensions.view.requests import Fault, ServiceCall, SetPointRequest, WeightChange
from hybrid_sysid_ros.extensions.view.server import Server
from hybrid_sysid_ros.extensions.view.tests.shown_rig import ShownRig

pytestmark = pytest.mark.skipif(not browser.found(), reason="needs a Chromium: install it, or name it in BROWSER_PATH")

SERVICES = ("stop", "estop", "hold", "enable", "reset", "arm", "disarm")
ENABLED = "[...document.querySelectorAll('#calls button')].filter(e => !e.disabled && !e.hidden).map(e => e.id)"


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


def test_the_reference_is_drawn_on_top(shown_rig: ShownRig, shown: Any) -> None:
    shown_rig.level = 1.0  # which the estimate crosses
    page = shown()
    time.sleep(1.0)
    found = pixels(page, ".chart.output .u-over", "reference")
    row = np.bincount(found[:, 1]).argmax()
    columns = np.unique(found[found[:, 1] == row, 0])
    assert np.diff(columns).max() == 1


def test_the_error_is_the_estimate_less_the_reference(shown: Any) -> None:
    page = shown()
    error = "+document.querySelector('.chart.error .note').textContent.match(/reference (-?[0-9.]+)/)[1]"
    estimate = "+document.querySelector('.chart.output').textContent.match(/estimate (-?[0-9.]+)/)[1]"
    found = page.until(f"[{error}, {estimate}]")
    assert found[0] == pytest.approx(found[1] - 5.0, abs=0.011)


def test_the_page_fits_a_laptop_without_scrolling(shown: Any) -> None:
    page = shown(width=1366, height=657)
    size = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    assert page.evaluate(size) == [1366, 657]
    outside = (
        "[...document.querySelectorAll('button, input, .chart, #drawing')].filter(e => e.checkVisibility())"
        ".map(e => e.getBoundingClientRect()).filter(r => r.right > 1366 || r.bottom > 657 || !r.height).length"
    )
    assert page.evaluate(outside) == 0


def test_the_rig_moves_as_its_joint_does(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    slopes = []
    for angle in (0.0, 0.2):
        shown_rig.angle = angle
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


def test_a_curve_is_asked_for_as_it_was_drawn(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    left, top, right, bottom = page.rectangle(".chart.output .u-over")
    width, height = right - left, bottom - top
    now = left + width * 8.0 / 11.0  # 8 s of the past, 3 s ahead
    step = width / 11.0
    page.drag([(now + step * (0.5 + 0.05 * k), top + height * (0.3 + 0.01 * k)) for k in range(31)])
    page.until("line.textContent == 'done as asked'")
    (asked,) = shown_rig.acted
    assert isinstance(asked, SetPointRequest)
    assert asked.times[0] == 0.0
    assert asked.values[0][0] == pytest.approx(5.0, abs=0.1)  # until then as it was
    assert asked.times[-1] == pytest.approx(2.0, abs=0.05)
    drawn = [value for time, (value,) in zip(asked.times, asked.values, strict=True) if time > 0.52]
    assert (np.diff(drawn) < 0.0).all()  # it was drawn downwards


def test_who_draws_sees_the_range_of_the_rig_and_keeps_to_its_zone(shown_rig: ShownRig, shown: Any) -> None:
    """The axis ends 6 % beyond the travel of +-10 V, whatever the data; set-points end at +-8 V."""
    page = shown()
    left, top, right, bottom = page.rectangle(".pad")
    shares = [0.25, 0.5, 0.02, 0.02, 0.98]
    page.drag([(left + (right - left) * (0.1 + 0.15 * k), top + (bottom - top) * y) for k, y in enumerate(shares)])
    page.until("line.textContent == 'done as asked'")
    (asked,) = shown_rig.acted
    assert isinstance(asked, SetPointRequest)
    drawn = [value for (value,) in asked.values[-len(shares) :]]
    assert drawn == pytest.approx([11.2 - 22.4 * 0.25, 0.0, 8.0, 8.0, -8.0], abs=0.2)


def test_escape_stops_whatever_has_the_focus(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    page.evaluate("document.querySelector('#setpoints input').focus()")
    page.press("Escape")
    page.until("line.textContent == 'done as asked'")
    assert shown_rig.acted == [ServiceCall(id=1, service="stop")]


ON = {
    ("driving", ""): ["stop", "estop", "hold", "reset", "disarm"],
    ("slowed", "the model is off"): ["stop", "estop", "hold", "reset", "disarm"],
    ("holding", "the sensor is doubted"): ["stop", "estop", "hold", "enable", "reset", "disarm"],
    ("holding", "holding the outputs until the service enable is called"): [
        *("stop", "estop", "enable", "reset", "disarm")
    ],
    ("resting", "the actuator is stuck"): ["stop", "estop", "hold", "enable", "reset", "disarm"],
    ("stopped", "until the service enable is called"): ["stop", "estop", "enable", "reset", "disarm"],
    ("disarmed", "disarmed (the service estop): call the services reset and arm"): ["stop", "estop", "reset"],
    ("disarmed", "not armed yet"): ["stop", "estop", "reset", "arm"],
}
"""Which buttons are on, by the state and its reason."""


def test_a_state_is_reported_and_what_does_nothing_in_it_is_off(shown_rig: ShownRig, shown: Any) -> None:
    shown_rig.services = SERVICES
    page, reason = shown(), "document.getElementById('state-reason').textContent"
    for (shown_rig.state, shown_rig.reason), wanted in ON.items():
        page.until(f"{reason} == '{shown_rig.reason or 'late'}'")
        assert page.evaluate("document.getElementById('state-word').textContent") == shown_rig.state
        assert page.evaluate("document.getElementById('state').dataset.sign") == shown_rig.state
        assert page.evaluate(ENABLED) == wanted
    shown_rig.values = {"ready": "no estimates come"}
    page.until(f"{reason} == 'not armed yet; not ready: no estimates come'")
    assert page.evaluate(ENABLED) == ["stop", "estop", "reset"]


def test_what_a_controller_does_not_offer_is_not_there(shown: Any) -> None:
    page = shown()
    page.until("document.getElementById('state-word').textContent == 'driving'")
    assert page.evaluate(ENABLED) == ["stop", "hold", "reset"]
    assert page.evaluate("[estop, arm, disarm].every(e => e.hidden)")


def test_weights_can_be_set_while_no_network_keeps_them(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    page.until("document.querySelector('[data-weight=rate_weight]').value == '1'")
    page.evaluate("weights.open = true")
    change = "e => { e.focus(); e.value = '2.5'; e.dispatchEvent(new Event('change')); e.blur(); }"
    page.evaluate(f"({change})(document.querySelector('[data-weight=rate_weight]'))")
    page.until("line.textContent == 'done as asked'")
    assert shown_rig.acted == [WeightChange(id=1, name="rate_weight", values=(2.5,))]
    shown_rig.values = {"policy": "supervised"}
    page.until("[...document.querySelectorAll('[data-weight]')].every(e => e.disabled)")


def test_time_begins_anew_when_the_clock_was_set(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    page.until("+time.textContent > 10")
    shown_rig.zero = 1.7e9
    page.until("+time.textContent < 5")
    time.sleep(0.5)
    assert page.evaluate("+time.textContent") < 5
    assert len(pixels(page, ".chart.output .u-over", "estimate")) > 10


@pytest.mark.slow
def test_a_page_goes_on_after_a_restart_of_its_server(shown_rig: ShownRig) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]

    def serve() -> Server:
        made = Server(shown_rig, port=port, pictures=30.0)
        made.start()
        return made

    is_driving = "document.getElementById('state-word').textContent == 'driving'"
    first = serve()
    with browser.Browser(first.url) as page:
        page.until(is_driving)
        first.close()
        page.until("document.getElementById('state').dataset.sign == 'lost'")
        assert page.evaluate(ENABLED) == []  # which nobody would do
        page.press("Escape")
        page.until("line.textContent.includes('Stop does not reach the rig')")
        second = serve()
        page.until(is_driving)
        second.close()
        (folder() / f"view-{port}.token").unlink()
        third = serve()
        try:
            page.until("!address.hidden")
            time.sleep(1.5)
            assert not third.refused
            assert not third.pages
            page.evaluate(f"document.getElementById('address-text').value = '{third.url}'")
            page.click("#address button")
            page.until(is_driving)
        finally:
            third.close()


def test_what_is_pressed_is_asked_for(shown_rig: ShownRig, shown: Any) -> None:
    page = shown()
    page.click("#faults button[data-name=brake]")
    page.until("line.textContent == 'done as asked'")
    assert shown_rig.acted == [Fault(id=1, name="brake", on=True)]
    assert page.evaluate("document.querySelector('#policies [aria-pressed=true]').dataset.name") == "exact"
    assert page.evaluate("health.textContent") == "1 WARN"


def test_a_page_that_is_loaded_anew_shows_the_same(shown: Any) -> None:
    page = shown()
    page.call("Page.reload")
    time.sleep(0.5)
    page.until("document.querySelectorAll('.chart canvas').length == 5 && +fps.textContent > 0")
    time.sleep(0.5)
    x = pixels(page, ".chart.output .u-over", "estimate")[:, 0]
    left, _, right, _ = page.rectangle(".chart.output .u-over")
    assert np.ptp(x) > 0.6 * (right - left)  # the past, too


def test_the_page_names_nothing_from_elsewhere() -> None:
    folder = Path(browser.__file__).parents[1] / "hybrid_sysid_ros" / "extensions" / "view" / "page"
    for path in folder.glob("*.*"):
        if path.name.startswith("uPlot") or path.suffix == ".txt":
            continue
        text = path.read_text(encoding="utf-8")
        assert "eval(" not in text
        assert "innerHTML" not in text
        assert "http" not in text.replace("http://www.w3.org/2000/svg", ""), path
