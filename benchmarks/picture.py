"""A picture of lines over time, as SVG: what a page of the documentation shows of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from hybrid_sysid_ros.extensions.friction_atlas.line_plots import ticks
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import written_file

WIDTH, LEFT, RIGHT, TOP, GAP, BOTTOM = 960, 58, 14, 44, 26, 40
COLOURS = ("#8b95a1", "#d98880", "#c9a227", "#2e7d4f", "#3f7fbf", "#e8710a", "#4a235a", "#0f8b8d")
GRID, TEXT = "#e1e5ea", "#2b3440"
DASHED = ' stroke-dasharray="5 3"'


@dataclass(frozen=True, kw_only=True)
class Panel:
    """label: of its axis, with the unit. lines: each (samples,), by name. held: whether values hold until the next."""

    label: str
    lines: Mapping[str, Array]
    height: int
    held: bool = False


def draw(path: Path, time: Array, panels: Sequence[Panel], *, title: str) -> Path:
    """Write panels above one another that share their time (samples,) [s]. One name has one colour in all of them; the
    last is dashed, so that what lies beneath it shows.
    """
    names = list(dict.fromkeys(name for panel in panels for name in panel.lines))
    colours = dict(zip(names, COLOURS, strict=False))
    height = TOP + sum(panel.height + GAP for panel in panels) + BOTTOM - GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        f'font-size="12" fill="{TEXT}"><title>{escape(title)}</title>',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
    ]
    left = float(LEFT)
    for name in names:
        style = f'stroke="{colours[name]}"{DASHED if name == names[-1] else ""}'
        parts.append(f'<path d="M{left:.0f} 20h18" {style} stroke-width="2.5"/>')
        parts.append(f'<text x="{left + 23:.0f}" y="24">{escape(name)}</text>')
        left += 42 + 6.6 * len(name)
    top = TOP
    for panel in panels:
        parts += _panel(panel, time, top, colours, last=panel is panels[-1])
        top += panel.height + GAP
    with written_file(path) as partial:
        partial.write_text("\n".join([*parts, "</svg>\n"]), encoding="utf-8")
    return path


def _panel(panel: Panel, time: Array, top: int, colours: Mapping[str, str], *, last: bool) -> list[str]:
    values = np.concatenate(list(panel.lines.values()))
    margin = 0.05 * float(values.max() - values.min())
    low, high = float(values.min()) - margin, float(values.max()) + margin

    def across(t: Array) -> Array:
        return LEFT + (WIDTH - LEFT - RIGHT) * (t - time[0]) / (time[-1] - time[0])

    def down(value: Array) -> Array:
        return top + panel.height * (high - value) / (high - low)

    parts = []
    for tick in ticks(low, high, 6):
        y = down(tick)
        parts.append(f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="{GRID}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in ticks(float(time[0]), float(time[-1]), 10):
        x = across(tick)
        parts.append(f'<path d="M{x:.1f} {top}v{panel.height}" stroke="{GRID}"/>')
        if last:
            parts.append(f'<text x="{x:.1f}" y="{top + panel.height + 17}" text-anchor="middle">{tick:g}</text>')
    if last:
        parts.append(f'<text x="{WIDTH / 2:.0f}" y="{top + panel.height + 34}" text-anchor="middle">time [s]</text>')
    middle = top + panel.height / 2
    parts.append(
        f'<text x="14" y="{middle:.0f}" text-anchor="middle" transform="rotate(-90 14 {middle:.0f})">'
        f"{escape(panel.label)}</text>"
    )
    for name, line in panel.lines.items():
        x, y = across(time), down(line)
        if panel.held:
            x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        style = f'stroke="{colours[name]}"{DASHED if name == list(colours)[-1] else ""}'
        parts.append(f'<polyline points="{points}" fill="none" {style} stroke-width="1.5"/>')
    return parts
