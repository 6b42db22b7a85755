"""Charts: pictures for language models, of where a rig is and of what a command would come to, as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.command_interface import RigState
from hybrid_sysid_ros.extensions.commander.language.forecast import Forecast
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extras import extra

with extra("mcp"):
    from PIL import Image, ImageDraw

WIDTH, ROW, LEFT, RIGHT = 640, 150, 60, 20  # pixels
BACK, GRID, TEXT, LINE, WANTED = "#ffffff", "#e1e5ea", "#2b3440", "#1f4e79", "#d97706"


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves of one quantity over time; the first is what is asked for, where there are two."""

    title: str
    time: Array
    curves: Sequence[Array]
    low: float
    high: float


def forecast_chart(rig: Rig, forecast: Forecast) -> bytes:
    """Outputs with their references, and inputs with their limits, over the time of a simulation."""
    loop, panels = forecast.loop, []
    for k, output in enumerate(set_point_ranges(rig)):
        if output.tracked and output.moves:
            shown = [rig.display[k].shown(values[:, k]) for values in (loop.references, loop.outputs)]
            panels.append(_panel(f"{output.name} [{output.unit}], asked and simulated", loop.time, shown))
    for k, (item, actuator) in enumerate(zip(rig.system.inputs, rig.actuators, strict=True)):
        values = loop.inputs[:, k]
        title = f"{item.name} [{item.unit}], limits {actuator.low:.4g} and {actuator.high:.4g}"
        panels.append(_panel(title, loop.time, [values]))
    return _png(panels)


def _panel(title: str, time: Array, curves: Sequence[Array]) -> Panel:
    low, high = float(np.min(curves)), float(np.max(curves))
    room = 0.05 * (high - low) or 1.0
    return Panel(title=title, time=time, curves=curves, low=low - room, high=high + room)


def _png(panels: Sequence[Panel]) -> bytes:
    picture = Image.new("RGB", (WIDTH, ROW * max(len(panels), 1)), BACK)
    draw = ImageDraw.Draw(picture)
    for row, panel in enumerate(panels):
        top, bottom = row * ROW + 22, (row + 1) * ROW - 18
        draw.rectangle((LEFT, top, WIDTH - RIGHT, bottom), outline=GRID)
        draw.text((LEFT, top - 16), panel.title, fill=TEXT)
        draw.text((4, top), f"{panel.high:.4g}", fill=TEXT)
        draw.text((4, bottom - 10), f"{panel.low:.4g}", fill=TEXT)
        draw.text((WIDTH - RIGHT - 50, bottom + 2), f"{panel.time[-1]:.4g} s", fill=TEXT)
        across = LEFT + (WIDTH - RIGHT - LEFT) * panel.time / max(float(panel.time[-1]), 1e-9)
        for k, curve in enumerate(panel.curves):
            up = bottom - (bottom - top) * (curve - panel.low) / (panel.high - panel.low)
            colour = WANTED if k == 0 and len(panel.curves) > 1 else LINE
            draw.line(np.column_stack([across, up]).ravel().tolist(), fill=colour, width=2)
    return _bytes(picture)


def state_chart(rig: Rig, state: RigState) -> bytes:
    """Where each output stands between the ends of its set-points, with what is asked of it, and each input."""
    bars = [
        (f"{output.name} [{output.unit}]", output.low, output.high)
        for output in set_point_ranges(rig)
        if output.tracked and output.moves
    ]
    bars += [
        (f"{item.name} [{item.unit}]", actuator.low, actuator.high)
        for item, actuator in zip(rig.system.inputs, rig.actuators, strict=True)
    ]
    picture = Image.new("RGB", (WIDTH, 60 * len(bars) + 10), BACK)
    draw = ImageDraw.Draw(picture)
    for row, (name, low, high) in enumerate(bars):
        top, value = 60 * row + 26, state.outputs.get(name, state.inputs.get(name, 0.0))

        def place(at: float, low: float = low, high: float = high) -> float:
            return LEFT + (WIDTH - RIGHT - LEFT) * float(np.clip((at - low) / (high - low), 0.0, 1.0))

        draw.text((LEFT, top - 18), f"{name}: {value:.4g}", fill=TEXT)
        draw.rectangle((LEFT, top, WIDTH - RIGHT, top + 16), fill=GRID)
        left, right = sorted((place(0.0), place(value)))
        draw.rectangle((left, top, right, top + 16), fill=LINE)
        if name in state.references:
            at = place(state.references[name])
            draw.line((at, top - 4, at, top + 20), fill=WANTED, width=3)
        draw.text((LEFT, top + 18), f"{low:.4g}", fill=TEXT)
        draw.text((WIDTH - RIGHT - 40, top + 18), f"{high:.4g}", fill=TEXT)
    return _bytes(picture)


def _bytes(picture: Image.Image) -> bytes:
    made = BytesIO()
    picture.save(made, format="PNG")
    return made.getvalue()
