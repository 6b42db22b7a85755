"""Plots of lines side by side, as SVG: a picture that a page of the documentation shows as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import write_text


def ticks(low: float, high: float, about: int) -> Array:
    """Round numbers within low and high, some so many."""
    rough = (high - low) / about
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min(factor for factor in (1, 2, 5, 10) if factor * power >= rough * 0.999)
    counts: Array = np.arange(np.ceil(low / step), np.floor(high / step) + 1, dtype=np.float64)
    return step * counts + 0.0  # -0 is no tick


WIDTH, HEIGHT, LEFT, TOP, BOTTOM, GAP = 230, 170, 52, 34, 40, 14
LEAST = 0.1
"""Of what is shown upwards, as part of its largest value: what hardly changes is shown as that."""
NOTHING = 1e-9
"""What is no larger is rounding: shown as zero between -1 and 1."""
LINE, SECOND, GRID, TEXT = "#1f4e79", "#8b95a1", "#e1e5ea", "#2b3440"


@dataclass(frozen=True, kw_only=True)
class Plot:
    """One plot. lines: (x, y) each, (samples,); the first is drawn on top."""

    title: str
    across: str
    up: str
    lines: Sequence[tuple[Array, Array]]
    logarithmic: bool = False
    """Across."""


def draw(path: Path, plots: Sequence[Plot], *, title: str) -> Path:
    """Write plots in a row, below a title."""
    width = len(plots) * (LEFT + WIDTH + GAP)
    height = TOP + HEIGHT + BOTTOM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="10" fill="{TEXT}"><title>{escape(title)}</title>',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for number, plot in enumerate(plots):
        parts += _plot(plot, number * (LEFT + WIDTH + GAP) + LEFT)
    write_text(path, "\n".join([*parts, "</svg>\n"]))
    return path


def _plot(plot: Plot, left: int) -> list[str]:
    lines = [(np.log10(x) if plot.logarithmic else x, y) for x, y in plot.lines]
    low, high = (edge([edge(x) for x, _ in lines]) for edge in (np.min, np.max))
    bottom, top = (edge([edge(y) for _, y in lines]) for edge in (np.min, np.max))
    middle, largest = 0.5 * (top + bottom), max(abs(float(top)), abs(float(bottom)))
    shown = max(float(top - bottom), LEAST * largest)
    half = 0.56 * (shown if shown > NOTHING else 1.0)
    bottom, top = middle - half, middle + half

    def across(x: Array) -> Array:
        return left + WIDTH * (x - low) / max(float(high - low), 1e-12)

    def down(y: Array) -> Array:
        return TOP + HEIGHT * (top - y) / (top - bottom)

    parts = [f'<text x="{left}" y="{TOP - 10}" font-weight="bold">{escape(plot.title)}</text>']
    for tick in ticks(float(bottom), float(top), 6):
        y = float(down(np.array(tick)))
        parts.append(f'<path d="M{left} {y:.1f}h{WIDTH}" stroke="{GRID}"/>')
        parts.append(f'<text x="{left - 4}" y="{y + 3:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in ticks(float(low), float(high), 4):
        x = float(across(np.array(tick)))
        shown = 10.0**tick if plot.logarithmic else tick
        parts.append(f'<path d="M{x:.1f} {TOP}v{HEIGHT}" stroke="{GRID}"/>')
        parts.append(f'<text x="{x:.1f}" y="{TOP + HEIGHT + 13}" text-anchor="middle">{shown:.3g}</text>')
    centre = left + WIDTH / 2
    parts.append(f'<text x="{centre}" y="{TOP + HEIGHT + 29}" text-anchor="middle">{escape(plot.across)}</text>')
    side, half = left - 40, TOP + HEIGHT / 2
    parts.append(
        f'<text x="{side}" y="{half}" text-anchor="middle" transform="rotate(-90 {side} {half})">'
        f"{escape(plot.up)}</text>"
    )
    for number, (xs, ys) in reversed(list(enumerate(lines))):
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across(xs), down(ys), strict=True))
        colour = SECOND if number else LINE
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>')
    return parts
