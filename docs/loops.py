"""The pictures of the front page: a simulated loop of each rig beside its drawing, and one of the beam that moves.

.venv/bin/python -m docs.loops      # writes docs/loop.svg and docs/rigs/NAME.svg; no clock is read, so they repeat
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.extensions.friction_atlas.line_plots import ticks
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.library.loops import Loop
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import written_file

HERE = Path(__file__).parent
WIDTH, LEFT, RIGHT, TOP, GAP, BOTTOM = 560, 266, 14, 34, 18, 28
HEIGHTS = (140, 62)
STAGE = (10.0, 34.0, 192.0, 254.0)
"""Where the drawing stands: left, top, right, bottom."""
SEEN = 0.2
"""By how much a line may be off without anybody who sees it [pixels]."""
FRAMES = 20.0  # 1/s, of what moves
STYLE = """
svg { --paper: #fff; --text: #2b3440; --grid: #e1e5ea; --still: #b9c1ca }
svg { --wanted: #8b95a1; --found: #1f6fb2; --input: #c7600a }
@media (prefers-color-scheme: dark) {
  svg { --paper: #1e2129; --text: #d7dce2; --grid: #3a404b; --still: #59626e }
  svg { --wanted: #8f99a5; --found: #6db3ee; --input: #f0a050 }
}
text { fill: var(--text) } .paper { fill: var(--paper) } .grid { stroke: var(--grid) }
.line { fill: none; stroke-width: 1.8 }
.wanted { stroke: var(--wanted) } .found { stroke: var(--found) } .input { stroke: var(--input) }
.body { fill: var(--found) } .still { fill: var(--still) } .flame { fill: var(--input) }
.mark { stroke: var(--paper); stroke-width: .012 }
"""
CONE = ("M-.32 0 .3 .055V-.055Z", "M.05 .035 .28 .055 .3 .16Z", "M.31 .04 .4 0 .31-.04Z")
"""The vehicle, whose joint is a throttle: body, fin and flame [m]."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """What is shown of a rig's loop: its reference, from when to when [s], and the outputs; inputs fill the rest."""

    rig: str
    reference: str
    start: float
    stop: float
    outputs: tuple[str, ...]


PICTURES = (
    Picture(rig="cam_beam", reference="hardware", start=24.0, stop=36.0, outputs=("position",)),
    Picture(rig="flexible_joint", reference="moves", start=15.0, stop=25.0, outputs=("link_speed",)),
    Picture(rig="wheel_motor", reference="moves", start=4.0, stop=13.0, outputs=("speed",)),
    Picture(rig="drill_string", reference="moves", start=0.0, stop=24.0, outputs=("bit_speed",)),
    Picture(rig="winged_cone", reference="manoeuvres", start=0.0, stop=90.0, outputs=("speed", "height")),
)


def draw(path: Path, picture: Picture, loop: Loop, *, moving: bool = False) -> None:
    """Write a picture of a loop. moving: the drawing moves, and the lines grow, as fast as the rig does."""
    rig, seconds = loop.rig, picture.stop - picture.start
    rows = (loop.time >= picture.start - 1e-9) & (loop.time <= picture.stop + 1e-9)
    time = loop.time[rows] - picture.start
    names = [item.name for item in rig.system.outputs]
    panels: list[tuple[str, dict[str, Array]]] = []
    for name in picture.outputs:
        k = names.index(name)
        wanted, found = (rig.display[k].shown(values[rows, k]) for values in (loop.reference, loop.outputs))
        panels.append((f"{name.replace('_', ' ')} [{rig.display[k].unit}]", {"wanted": wanted, "found": found}))
    if len(panels) < len(HEIGHTS):
        variable = rig.system.inputs[0]
        panels.append((f"{variable.name.replace('_', ' ')} [{variable.unit}]", {"input": loop.inputs[rows, 0]}))
    height = TOP + sum(HEIGHTS) + GAP + BOTTOM
    title = f"The loop of {rig.name}: reference, output and input over {seconds:g} s"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        f'font-family="sans-serif" font-size="15"><title>{escape(title)}</title>',
        f"<style>{STYLE}{''.join(_moves(loop, rows, seconds)) if moving else ''}</style>",
        f'<rect class="paper" width="{WIDTH}" height="{height}" rx="6"/>',
        *_stage(rig, moving=moving),
        *_legend(panels),
    ]
    top = TOP
    for (label, lines), tall in zip(panels, HEIGHTS, strict=True):
        parts += _panel(label, lines, time, top, tall, last=top > TOP)
        top += tall + GAP
    with written_file(path) as partial:
        partial.write_text("\n".join([*parts, "</svg>\n"]), encoding="utf-8")


def _legend(panels: Sequence[tuple[str, dict[str, Array]]]) -> Iterator[str]:
    names = {"wanted": "reference", "found": "output", "input": "input"}
    left = LEFT
    for name in dict.fromkeys(name for _, lines in panels for name in lines):
        yield f'<path class="line {name}" d="M{left} 17h16"/><text x="{left + 21}" y="21">{names[name]}</text>'
        left += 46 + 8 * len(names[name])


def _panel(label: str, lines: dict[str, Array], time: Array, top: int, height: int, *, last: bool) -> Iterator[str]:
    values = np.concatenate(list(lines.values()))
    margin = 0.08 * float(np.ptp(values))
    low, high = float(values.min()) - margin, float(values.max()) + margin
    wide = WIDTH - LEFT - RIGHT
    for tick in ticks(low, high, height // 24):
        y = top + height * (high - tick) / (high - low)
        yield f'<path class="grid" d="M{LEFT} {y:.1f}h{wide}"/>'
        yield f'<text x="{LEFT - 6}" y="{y + 5:.1f}" text-anchor="end">{tick:g}</text>'
    for tick in ticks(0.0, float(time[-1]), 6):
        x = LEFT + wide * tick / time[-1]
        yield f'<path class="grid" d="M{x:.1f} {top}v{height}"/>'
        if last:
            unit = " s" if tick else ""
            yield f'<text x="{x:.1f}" y="{top + height + 20}" text-anchor="middle">{tick:g}{unit}</text>'
    middle = top + height / 2
    yield (
        f'<text x="209" y="{middle:.0f}" font-size="14" text-anchor="middle" transform="rotate(-90 209 {middle:.0f})">'
        f"{escape(label)}</text>"
    )
    for name, line in lines.items():
        across, down = LEFT + wide * time / time[-1], top + height * (high - line) / (high - low)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _thinned(np.column_stack([across, down])))
        grows = "" if name == "wanted" else " grows"
        yield f'<g class="line{grows}"><polyline class="line {name}" points="{points}"/></g>'


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


def _stage(rig: hs.Rig, *, moving: bool) -> Iterator[str]:
    """The drawing of a rig, as large as its place."""
    left, top, right, bottom = STAGE
    drawing = Drawing(rig)
    drawn = any(rig.content.get("drawing", {}))
    x0, y0, x1, y1 = drawing.extent() if drawn else (-0.34, -0.2, 0.4, 0.2)
    scale = min((right - left) / (x1 - x0), (bottom - top) / (y1 - y0))
    x, y = (left + right - scale * (x0 + x1)) / 2, (top + bottom + scale * (y0 + y1)) / 2
    yield f'<g transform="translate({x:.1f} {y:.1f}) scale({scale:.1f} {-scale:.1f})">'
    if drawn:
        for body in drawing.description():
            yield from _body(body)
    else:
        yield from (f'<path class="{kind}" d="{d}"/>' for kind, d in zip(("body", "still", "flame"), CONE, strict=True))
    yield "</g>"


def _body(body: dict[str, Any]) -> Iterator[str]:
    kind = "body" if body["joint"] else "still"
    yield f'<g transform="translate({body["at"][0]} {body["at"][1]})"><g class="{kind} joint-{body["joint"]}">'
    for shape in body["shapes"]:
        (x, y), box, disc = shape["at"], shape["box"], shape["disc"]
        if box:
            yield f'<rect x="{x - box[0] / 2:.4g}" y="{y - box[1] / 2:.4g}" width="{box[0]}" height="{box[1]}"/>'
        else:
            yield f'<circle cx="{x}" cy="{y}" r="{disc}"/>'
            if body["joint"]:
                yield f'<path class="mark" d="M{x} {y}V{y + 0.8 * disc:.4g}"/>'
    yield "</g></g>"


def _moves(loop: Loop, rows: Array, seconds: float) -> Iterator[str]:
    """Style of what moves, unless its reader prefers stillness: bodies by their joints' positions, lines that grow."""
    time, rig = loop.time[rows] - loop.time[rows][0], loop.rig
    names = [item.name for item in rig.system.states]
    at, endless = np.arange(0.0, seconds + 1e-9, 1.0 / FRAMES), f"{seconds:g}s linear infinite"
    yield "@media (prefers-reduced-motion: no-preference) {\n"
    for name, joint in rig.joints.joints.items():
        if joint.position in names:
            angles = np.degrees(np.interp(at, time, loop.states[rows, names.index(joint.position)]))
            frames = zip(100.0 * at / seconds, angles, strict=True)
            turns = "".join(f"{share:.4g}%{{transform:rotate({angle:.2f}deg)}}" for share, angle in frames)
            yield f"@keyframes {name} {{ {turns} }} .joint-{name} {{ animation: {name} {endless} }}\n"
    yield (
        "@keyframes grow { from { clip-path: inset(0 100% 0 0) } to { clip-path: inset(0) } } "
        f".grows {{ animation: grow {endless} }}\n}}\n"
    )


if __name__ == "__main__":
    for picture in PICTURES:
        loop = hs.simulate(picture.rig, controller="supervised", reference=picture.reference, seconds=picture.stop)
        draw(HERE / "rigs" / f"{picture.rig}.svg", picture, loop)
        if picture.rig == "cam_beam":
            draw(HERE / "loop.svg", picture, loop, moving=True)
