"""The pictures of the live view's page: a desk, and three looks at a phone, of the beam's loop as it runs.

.venv/bin/python -m docs.view_pictures      # with a Chromium
"""

from __future__ import annotations

import threading
import time
from pathlib import Path

from PIL import Image

from benchmarks.browser import Browser
from hybrid_sysid_ros.extensions.view.companion import View
from hybrid_sysid_ros.runtime.run import Run

HERE = Path(__file__).parent
DESK, PHONE, GAP = (1366, 700), (390, 844), 24  # px
SETTLED = 9.0  # s, until the charts are full
SECONDS = 45.0  # of the run


def desk(url: str) -> Image.Image:
    """The whole page, while a set-point is drawn in its chart."""
    width, height = DESK
    with Browser(url, width=width, height=height) as page:
        page.until("+fps.textContent > 0")
        time.sleep(SETTLED)
        left, top, right, bottom = page.rectangle(".pad")
        points = [
            (left + (0.1 + 0.06 * k) * (right - left), top + (0.3 + 0.03 * k) * (bottom - top)) for k in range(13)
        ]
        for kind, (x, y) in [("mousePressed", points[0]), *(("mouseMoved", point) for point in points)]:
            page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        page.until("!!document.querySelector('.pad.ranged')")
        picture = page.picture()
        page.press("Escape")  # which stops the loop, too
        page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)
        page.until("!document.getElementById('enable').disabled")
        page.click("#enable")
        page.until("document.getElementById('state-word').textContent == 'driving'")
    return picture


def phone(url: str) -> Image.Image:
    """Driving, its controls, and stopped in dark mode, side by side."""
    width, height = PHONE
    shown = Image.new("RGB", (3 * width + 2 * GAP, height), "white")
    for k in range(3):
        with Browser(url, width=width, height=height, touch=True, dark=k == 2) as page:
            page.until("document.getElementById('state-word').textContent == 'driving'")
            time.sleep(SETTLED / 3)
            if k == 1:
                page.evaluate("document.getElementById('left').scrollIntoView(); scrollBy(0, -130)")
            if k == 2:
                page.press("Escape")
                page.until("document.getElementById('state-word').textContent == 'stopped'")
            time.sleep(1.0)
            shown.paste(page.picture(), (k * (width + GAP), 0))
    return shown


def main() -> None:
    """Run the loop, and write live_view.png and live_view_phone.png."""
    address, drawn = [], {}

    def tell(line: str) -> None:
        if line.startswith("live view: "):
            address.append(line.removeprefix("live view: "))
            threading.Thread(target=look, daemon=True).start()

    def look() -> None:
        for name, draw in {"live_view": desk, "live_view_phone": phone}.items():
            drawn[name] = draw(address[0])

    Run(reference="sine", duration=SECONDS, companions=[View(port=0)], tell=tell).go()
    for name, picture in drawn.items():
        picture.quantize(128).save(HERE / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
