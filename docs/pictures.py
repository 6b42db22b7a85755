"""The pictures of docs/results/cam-beam.md, cut out of the page that ``HYBRID_SYSID_DATA=FOLDER make demo`` writes.

.venv/bin/python -m docs.pictures out/demo/report.html 03_random_steps_03      # with a Chromium
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.browser import Browser

HERE = Path(__file__).parent
WIDTH, HEIGHT, MARGIN = 1116, 9000, 6
SCRIPT = """
const cards = [...document.querySelectorAll('.card')];
cards.find(card => card.querySelector('h3')?.firstChild.data.endsWith(RECORD)).dataset.picture = 'run';
let loop = document.querySelector('#closed-loop').nextElementSibling;
while (!loop.querySelector('.main-svg')) loop = loop.nextElementSibling;
loop.dataset.picture = 'loop';
loop.nextElementSibling.dataset.picture = 'zooms';
true
"""


def draw(page: Path, record: str) -> None:
    """Write free_run.png, of one record, and loop.png."""
    with Browser(page.resolve().as_uri(), width=WIDTH, height=HEIGHT) as browser:
        browser.until("document.querySelectorAll('.main-svg').length > 4")
        browser.evaluate(SCRIPT.replace("RECORD", repr(record)))
        picture = browser.picture()
        for name, parts in {"free_run": ("run", "run"), "loop": ("loop", "zooms")}.items():
            (left, top, *_), (*_, right, bottom) = [browser.rectangle(f"[data-picture={part}]") for part in parts]
            area = (left - MARGIN, top - MARGIN, right + MARGIN, bottom + MARGIN)
            cut = picture.crop(tuple(round(value) for value in area))
            cut.quantize(256).save(HERE / f"{name}.png", optimize=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), sys.argv[2])
