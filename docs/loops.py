"""The pictures of the front page: a simulated loop of each rig beside its drawing, and one of the beam that moves.

.venv/bin/python -m docs.loops      # writes docs/loop.svg and docs/rigs/NAME.svg; no clock is read, so they repeat
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import hybrid_sysid_ros as hs
from docs.lines import Line, Panel, draw
from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.extensions.view.svg_drawing import bodies
from hybrid_sysid_ros.library.loops import Loop
from hybrid_sysid_ros.support.arrays import Array

HERE = Path(__file__).parent
LEFT, LOW = 266, 62
"""Where the axes begin, and the height of the lower panel [pixels]."""
STAGE = (10.0, 34.0, 192.0, 254.0)
"""Where the drawing stands: left, top, right, bottom."""
FRAMES = 20.0  # 1/s, of what moves
STYLE = """
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
    Picture(rig="drill_string", reference="moves", start=0.0, stop=23.0, outputs=("bit_speed",)),
    Picture(rig="winged_cone", reference="manoeuvres", start=0.0, stop=90.0, outputs=("speed", "height")),
    Picture(rig="balancing_robot", reference="moves", start=0.0, stop=20.0, outputs=("speed", "yaw")),
)


def draw_loop(path: Path, picture: Picture, loop: Loop, *, moving: bool = False) -> None:
    """Write a picture of a loop. moving: the drawing moves, and the lines grow, as fast as the rig does."""
    rig, seconds = loop.rig, picture.stop - picture.start
    rows = (loop.time >= picture.start - 1e-9) & (loop.time <= picture.stop + 1e-9)
    names = [item.name for item in rig.system.outputs]
    panels = []
    for name in picture.outputs:
        k = names.index(name)
        wanted, found = (rig.display[k].shown(values[rows, k]) for values in (loop.reference, loop.outputs))
        lines = [
            Line(name="reference", values=wanted, colour="wanted"),
            Line(name="output", values=found, grows=True),
        ]
        label = f"{name.replace('_', ' ')} [{rig.display[k].unit}]"
        panels.append(Panel(label=label, lines=lines, height=LOW if panels else 140))
    if len(panels) < 2:
        variable = rig.system.inputs[0]
        line = Line(name="input", values=loop.inputs[rows, 0], colour="input", grows=True)
        panels.append(Panel(label=f"{variable.name} [{variable.unit}]", lines=[line], height=LOW))
    draw(
        path,
        loop.time[rows] - picture.start,
        panels,
        title=f"The loop of {rig.name}: reference, output and input over {seconds:g} s",
        left=LEFT,
        style=STYLE + ("".join(_moves(loop, rows, seconds)) if moving else ""),
        beside=_stage(rig),
    )


def _stage(rig: hs.Rig) -> Iterator[str]:
    """The drawing of a rig, as large as its place."""
    left, top, right, bottom = STAGE
    drawing = Drawing(rig)
    drawn = any(rig.content.get("drawing", {}))
    x0, y0, x1, y1 = drawing.extent() if drawn else (-0.34, -0.2, 0.4, 0.2)
    scale = min((right - left) / (x1 - x0), (bottom - top) / (y1 - y0))
    x, y = (left + right - scale * (x0 + x1)) / 2, (top + bottom + scale * (y0 + y1)) / 2
    yield f'<g transform="translate({x:.1f} {y:.1f}) scale({scale:.1f} {-scale:.1f})">'
    if drawn:
        yield from bodies(drawing)
    else:
        yield from (f'<path class="{kind}" d="{d}"/>' for kind, d in zip(("body", "still", "flame"), CONE, strict=True))
    yield "</g>"


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
        draw_loop(HERE / "rigs" / f"{picture.rig}.svg", picture, loop)
        if picture.rig == "cam_beam":
            draw_loop(HERE / "loop.svg", picture, loop, moving=True)
