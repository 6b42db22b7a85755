"""The page on a phone, a tablet and a desk: what can be read, reached and pressed, with fingers and by keyboard."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")
pytest.importorskip("PIL", reason="needs Pillow: install hybrid_sysid_ros[dev]")

from benchmarks import browser
from hybrid_sysid_ros.extensions.view.requests import ServiceCall, SetPointRequest
from hybrid_sysid_ros.extensions.view.tests.shown_rig import ShownRig, opening
from hybrid_sysid_ros.rigs.rig import Rig

pytestmark = pytest.mark.skipif(not browser.found(), reason="needs a Chromium: install it, or name it in BROWSER_PATH")

SIZES = {
    "phone": {"width": 390, "height": 844, "touch": True},
    "tablet": {"width": 820, "height": 1180, "touch": True},
    "desk": {"width": 1440, "height": 900, "touch": False},
}
TAP = {"phone": 44, "tablet": 44, "desk": 24}  # px: WCAG 2.2, 2.5.5 for fingers and 2.5.8 for a mouse
CONTRAST, LARGE = 4.5, 3.0
"""Least contrasts of texts, and of texts of at least 24 px, or 18.66 px in bold (WCAG 2.2, 1.4.3)."""
CONTROLS = "[...document.querySelectorAll('button, input, summary')].filter(e => e.checkVisibility())"
STATES = ("driving", "slowed", "holding", "resting", "stopped", "disarmed", "another")

MEASURED_CONTRASTS = """(() => {
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
  const luminance = ([r, g, b]) => [r, g, b].map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = (e) => {
    const colour = numbers(getComputedStyle(e).backgroundColor);
    return colour.length < 4 || colour[3] === 1 ? colour : behind(e.parentElement);
  };
  const found = [];
  for (const e of document.querySelectorAll('body *')) {
    const written = [...e.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!(written || e.matches('input[type=number]')) || !e.checkVisibility() || e.closest(':disabled')) continue;
    const style = getComputedStyle(e), size = parseFloat(style.fontSize), bold = Number(style.fontWeight) >= 700;
    const [dark, light] = [numbers(style.color), behind(e)].map(luminance).sort((a, b) => a - b);
    const large = size >= 24 || (bold && size >= 18.66);
    const name = (e.id || e.className || e.tagName) + ': ' + e.textContent.slice(0, 30);
    found.push([name, (light + 0.05) / (dark + 0.05), large]);
  }
  return found;
})()"""


@pytest.fixture(scope="module", params=list(SIZES))
def size(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def desk(rig: Rig, size: str, chromium: browser.Chromium) -> Iterator[tuple[ShownRig, browser.Browser]]:
    """A rig with all that a controller can offer, and its page."""
    shown = ShownRig(rig, services=("stop", "estop", "hold", "enable", "reset", "arm", "disarm"))
    with opening(shown, chromium) as show:
        yield shown, show(**SIZES[size])


@pytest.fixture
def shown_rig(desk: tuple[ShownRig, browser.Browser]) -> ShownRig:
    desk[0].state = "driving"
    desk[0].acted.clear()
    return desk[0]


@pytest.fixture
def page(desk: tuple[ShownRig, browser.Browser], shown_rig: ShownRig) -> browser.Browser:
    """As after it was opened, with the weights unfolded."""
    opened = desk[1]
    opened.evaluate("document.activeElement.blur(); scrollTo(0, 0); weights.open = true")
    opened.until("!document.querySelector('[data-weight]').disabled && !estop.hidden")
    return opened


def test_all_texts_stand_out_in_each_state_and_theme(page: browser.Browser, shown_rig: ShownRig) -> None:
    seen = 0
    for state in STATES:  # outside: a theme shows at once, a state comes with the next message
        shown_rig.state = state
        page.until(f"document.getElementById('state-word').textContent == '{state}'")
        for _ in ("light", "dark"):
            page.evaluate("document.getElementById('theme').click()")
            theme = page.evaluate("document.documentElement.dataset.theme")
            found = page.evaluate(MEASURED_CONTRASTS)
            faint = [(theme, state, *each) for each in found if each[1] < (LARGE if each[2] else CONTRAST)]
            assert not faint
            seen += len(found)
    assert seen > 30 * 2 * len(STATES)


def test_states_differ_in_more_than_their_colour(page: browser.Browser, shown_rig: ShownRig) -> None:
    signs = set()
    for state in STATES[:-1]:
        shown_rig.state = state
        page.until(f"document.getElementById('state-word').textContent == '{state}'")
        signs.add(page.evaluate("document.querySelector(document.querySelector('#state use').href.baseVal).innerHTML"))
    assert len(signs) == len(STATES) - 1


def test_nothing_is_too_small_for_what_it_is_pressed_with(page: browser.Browser, size: str) -> None:
    sizes = page.evaluate(
        f"{CONTROLS}.map(e => [e.id || e.textContent, e.getBoundingClientRect()])"
        ".map(([name, r]) => [name, r.width, r.height])"
    )
    least = TAP[size] if size != "desk" else 20.0  # a slider's thumb, within its 30 px
    assert len(sizes) > 20
    assert not [each for each in sizes if min(each[1:]) < least - 0.5]


def test_each_control_has_a_name(page: browser.Browser) -> None:
    page.call("Accessibility.enable")
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    roles = {"button", "slider", "spinbutton", "textbox", "image", "DisclosureTriangle"}
    found = [node for node in nodes if not node["ignored"] and node["role"]["value"] in roles]
    assert len(found) > 20
    assert not [node["role"]["value"] for node in found if not node.get("name", {}).get("value", "").strip()]


def test_all_is_reached_and_stop_never_leaves_the_screen(page: browser.Browser, size: str) -> None:
    width, height = SIZES[size]["width"], SIZES[size]["height"]
    assert page.evaluate("document.documentElement.scrollWidth") == width
    hidden = (
        "(e => { e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
        " const at = document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2);"
        " return !(r.left >= 0 && r.right <= innerWidth && (e === at || e.contains(at))); })"
    )
    unreached = f"{CONTROLS}.concat(...document.querySelectorAll('.chart, tr')).filter({hidden})"
    assert page.evaluate(f"{unreached}.map(e => e.id || e.textContent)") == []
    for place in (0, 300, 1e6):
        page.evaluate(f"scrollTo(0, {place})")
        left, top, right, bottom = page.rectangle("#stop")
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
        at = f"document.elementFromPoint({(left + right) / 2}, {(top + bottom) / 2})"
        assert page.evaluate(f"{at}.closest('button').id") == "stop"


def test_all_is_done_by_keyboard_alone(page: browser.Browser, shown_rig: ShownRig) -> None:
    page.evaluate("window.isOld = true")
    page.call("Page.reload")  # the Tab key goes on from where somebody has been
    page.until("!window.isOld && Number(document.getElementById('fps')?.textContent) > 0")
    page.evaluate("weights.open = true")
    page.until("!document.querySelector('[data-weight]').disabled && !estop.hidden")
    wanted = set(page.evaluate(f"{CONTROLS}.filter(e => !e.disabled).map((e, k) => e.dataset.at = String(k))"))
    order = []
    for _ in range(len(wanted)):
        page.press("Tab")
        order.append(page.evaluate("document.activeElement.dataset.at"))
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        if page.evaluate("document.activeElement.type") == "range":
            page.press("ArrowRight")
        if len(order) == 1:
            page.press(" ")  # Stop comes first
    assert set(order) == wanted
    end = time.monotonic() + browser.PATIENCE
    while len(shown_rig.acted) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    stop, moved = shown_rig.acted
    assert isinstance(stop, ServiceCall)
    assert stop.service == "stop"
    assert isinstance(moved, SetPointRequest)
    assert moved.values[0][0] == pytest.approx(5.0, abs=0.5)
    assert moved.values[0][0] > 5.0


@pytest.mark.skipif("AXE_PATH" not in os.environ, reason="needs axe.min.js of axe-core: name it in AXE_PATH")
def test_axe_finds_nothing(page: browser.Browser) -> None:
    """Deque's axe-core, all its rules for WCAG 2.2 A and AA, and its best practices."""
    page.evaluate(Path(os.environ["AXE_PATH"]).read_text(encoding="utf-8"))
    time.sleep(0.5)
    for _ in ("light", "dark"):
        shown = "v => [v.id, v.nodes.map(n => n.html).slice(0, 3)]"
        found = page.evaluate(f"axe.run().then(r => r.violations.map({shown}))")
        assert not found, json.dumps(found, indent=1)
        page.evaluate("document.getElementById('theme').click()")
