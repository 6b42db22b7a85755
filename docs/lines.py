"""Lines over time as SVG for the pages, which are dark where their reader wants it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from hybrid_sysid_ros.extensions.friction_atlas.line_plots import ticks
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import written_file

WIDTH, RIGHT, TOP, GAP, BOTTOM, LABEL = 560, 22, 34, 18, 28, 57
"""Of the drawing; LABEL is from the label of an axis to the axis."""
PAGE = 720
"""Width on a page that is wide enough [pixels]."""
SEEN = 0.4
"""By how much a line may be off without anybody who sees it [pixels]."""
STYLE = """
svg { --paper: #fff; --text: #2b3440; --grid: #e1e5ea; --still: #b9c1ca }
svg { --wanted: #8b95a1; --found: #1f6fb2; --input: #c7600a; --other: #2e7d4f }
@media (prefers-color-scheme: dark) {
  svg { --paper: #1e2129; --text: #d7dce2; --grid: #3a404b; --still: #59626e }
  svg { --wanted: #8f99a5; --found: #6db3ee; --input: #f0a050; --other: #6fc793 }
}
text { fill: var(--text) } .paper { fill: var(--paper) } .grid { stroke: var(--grid) }
.shade { fill: var(--grid); opacity: .6 }
.line { fill: none; stroke-width: 1.8 } .wanted { stroke: var(--wanted) } .found { stroke: var(--found) }
.input { stroke: var(--input) } .other { stroke: var(--other) }
"""


@dataclass(frozen=True, kw_only=True)
class Line:
    """values: (samples,). colour: wanted, found, input or other. grows: whether it grows where a picture moves."""

    name: str
    values: Array
    colour: str = "found"
    grows: bool = False


@dataclass(frozen=True, kw_only=True)
class Panel:
    """label: of its axis, with the unit. shaded: from when to when [s]."""

    label: str
    lines: Sequence[Line]
    height: int = 140
    shaded: tuple[float, float] | None = None


def draw(
    path: Path,
    time: Array,
    panels: Sequence[Panel],
    *,
    title: str,
    left: int = 70,
    style: str = "",
    beside: Iterable[str] = (),
) -> None:
    """Write panels above one another that share their time (samples,) [s]. beside: what stands left of them."""
    height = TOP + sum(panel.height + GAP for panel in panels) - GAP + BOTTOM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{PAGE}" '
        f'height="{height * PAGE / WIDTH:.0f}" role="img" font-family="sans-serif" font-size="15">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}{style}</style>",
        f'<rect class="paper" width="{WIDTH}" height="{height}" rx="6"/>',
        *beside,
        *_legend(panels, left),
    ]
    top = TOP
    for panel in panels:
        parts += _panel(panel, time, left, top, last=panel is panels[-1])
        top += panel.height + GAP
    with written_file(path) as partial:
        partial.write_text("\n".join([*parts, "</svg>\n"]), encoding="utf-8")


def _legend(panels: Sequence[Panel], left: int) -> Iterator[str]:
    for name, colour in {line.name: line.colour for panel in panels for line in panel.lines}.items():
        yield f'<path class="line {colour}" d="M{left} 17h16"/><text x="{left + 21}" y="21">{escape(name)}</text>'
        left += 46 + 8 * len(name)


def _panel(panel: Panel, time: Array, left: int, top: int, *, last: bool) -> Iterator[str]:
    values = np.concatenate([line.values for line in panel.lines])
    margin = 0.08 * float(np.ptp(values))
    low, high = float(values.min()) - margin, float(values.max()) + margin
    wide, height, end = WIDTH - left - RIGHT, panel.height, float(time[-1])
    if panel.shaded:
        first, until = (wide * second / end for second in panel.shaded)
        yield f'<rect class="shade" x="{left + first:.1f}" y="{top}" width="{until - first:.1f}" height="{height}"/>'
    for tick in ticks(low, high, height // 24):
        y = top + height * (high - tick) / (high - low)
        yield f'<path class="grid" d="M{left} {y:.1f}h{wide}"/>'
        yield f'<text x="{left - 6}" y="{y + 5:.1f}" text-anchor="end">{tick:g}</text>'
    for tick in ticks(0.0, end, 6):
        x = left + wide * tick / end
        yield f'<path class="grid" d="M{x:.1f} {top}v{height}"/>'
        if last:
            unit = " s" if tick else ""
            yield f'<text x="{x:.1f}" y="{top + height + 20}" text-anchor="middle">{tick:g}{unit}</text>'
    middle, x = top + height / 2, left - LABEL
    yield (
        f'<text x="{x}" y="{middle:.0f}" font-size="14" text-anchor="middle" transform="rotate(-90 {x} {middle:.0f})">'
        f"{escape(panel.label)}</text>"
    )
    for line in panel.lines:
        across, down = left + wide * time / end, top + height * (high - line.values) / (high - low)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _thinned(np.column_stack([across, down])))
        grows = " grows" if line.grows else ""
        yield f'<g class="line{grows}"><polyline class="line {line.colour}" points="{points}"/></g>'


def _thinned(points: Array) -> Array:
    """The points (n, 2) of a line that are seen in it (Ramer 1972, by distances along y)."""
    kept, parts = {0, len(points) - 1}, [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        (x0, y0), (x1, y1) = points[first], points[last]
        x, y = points[first : last + 1].T
        off = np.abs(y - y0 - (y1 - y0) * (x - x0) / (x1 - x0))
        middle = first + int(off.argmax())
        if off.max() > SEEN:
            kept.add(middle)
            parts += [(first, middle), (middle, last)]
    return points[sorted(kept)]
