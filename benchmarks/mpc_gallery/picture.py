"""The picture of the gallery: a small panel for each problem, with its optimal course."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from benchmarks.mpc_gallery.case import Case
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import written_file

WIDTH, HEIGHT, EDGE, COLUMNS = 184, 120, 8, 5
"""Of a panel, and how many are side by side."""
GRID, TEXT, LINE = "#e1e5ea", "#2b3440", "#0f8b8d"


def draw(path: Path, answers: Mapping[str, tuple[Case, Array]]) -> Path:
    """Write the courses (N + 1, n) of cases as SVG."""
    rows = -(-len(answers) // COLUMNS)
    wide, high = COLUMNS * (WIDTH + 2 * EDGE), rows * (HEIGHT + 56)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" font-family="sans-serif" '
        f'font-size="12" fill="{TEXT}"><title>Optimal courses of the problems</title>',
        f'<rect width="{wide}" height="{high}" fill="#ffffff"/>',
    ]
    for number, (name, (case, states)) in enumerate(answers.items()):
        left, top = EDGE + number % COLUMNS * (WIDTH + 2 * EDGE), 22 + number // COLUMNS * (HEIGHT + 56)
        parts += _panel(name.replace("_", " "), case, states, left, top)
    with written_file(path) as partial:
        partial.write_text("\n".join([*parts, "</svg>\n"]), encoding="utf-8")
    return path


def _panel(title: str, case: Case, states: Array, left: int, top: int) -> list[str]:
    known: dict[str, tuple[str, Array]] = {
        item.name: (item.unit, states[:, k]) for k, item in enumerate(case.system.states)
    }
    known[""] = ("s", case.problem.period * np.arange(len(states), dtype=np.float64))
    (unit, x), (other, y) = (known[name] for name in case.drawn)
    right = EDGE + (WIDTH - 2 * EDGE) * (x - x.min()) / np.ptp(x)
    down = EDGE + (HEIGHT - 2 * EDGE) * (y.max() - y) / np.ptp(y)
    points = " ".join(f"{left + a:.1f},{top + b:.1f}" for a, b in zip(right, down, strict=True))
    across, up = case.drawn[0] or "time", case.drawn[1]
    below = f"{across} {x.min():.3g} to {x.max():.3g} {unit}", f"{up} {y.min():.3g} to {y.max():.3g} {other}"
    return [
        f'<text x="{left}" y="{top - 7}" font-weight="bold">{escape(title)}</text>',
        f'<rect x="{left}" y="{top}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="{GRID}"/>',
        f'<polyline points="{points}" fill="none" stroke="{LINE}" stroke-width="1.5"/>',
        f'<circle cx="{left + right[0]:.1f}" cy="{top + down[0]:.1f}" r="3" fill="{LINE}"/>',
        f'<text x="{left}" y="{top + HEIGHT + 13}" font-size="10">{escape(below[0])}</text>',
        f'<text x="{left}" y="{top + HEIGHT + 25}" font-size="10">{escape(below[1])}</text>',
    ]
