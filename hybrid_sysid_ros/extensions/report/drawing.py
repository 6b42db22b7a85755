"""Drawing: a free run or a closed loop over time as a single figure, for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extras import extra

HEIGHT, LOW = 230, 130
"""Height of a panel with an output, and of one with an error or an input [pixels]."""


def free_run_figure(
    rig: Rig, time: Array, measured: Array, simulated: Array, bands: Mapping[float, Array] | None = None
) -> Any:
    """A plotly figure of measured and simulated outputs (samples, p) [SI], each with its difference
    below. bands: half widths (samples, p) by level. Raises UserError without plotly.
    """
    rows = [height for _ in rig.display for height in (HEIGHT, LOW)]
    charts, figure = _panels(rows)
    for k, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
        one, other, row = display.shown(measured[:, k]), display.shown(simulated[:, k]), 1 + 2 * k
        for level, half in sorted((bands or {}).items(), reverse=True):
            width = display.shown(half[:, k])
            charts.area(figure, row, time, other - width, other + width, f"{level:.0%} band", legend=not k)
            charts.area(figure, row + 1, time, -width, width, f"{level:.0%} band", legend=False)
        charts.line(figure, row, time, one, "measured", charts.MEASURED, legend=not k)
        charts.line(figure, row, time, other, "free run", charts.MODEL, legend=not k)
        difference = f"measured {charts.MINUS} free run"
        charts.line(figure, row + 1, time, one - other, difference, charts.ERROR, legend=not k)
        charts.scaled(figure, row, [one, other], item.name, item, display)
        charts.scaled(figure, row + 1, [one - other], "difference", item, display, symmetric=True)
    return charts.timed(figure, len(rows))


def loop_figure(rig: Rig, time: Array, outputs: Array, references: Array, inputs: Array) -> Any:
    """A plotly figure of outputs with their references (samples, p), and inputs (samples, m) with their
    bounds, SI. Raises UserError without plotly.
    """
    rows = [HEIGHT] * len(rig.display) + [LOW] * len(rig.actuators)
    charts, figure = _panels(rows)
    for k, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
        wanted, found = display.shown(references[:, k]), display.shown(outputs[:, k])
        charts.line(figure, 1 + k, time, found, "output", charts.MEASURED, legend=not k)
        charts.line(figure, 1 + k, time, wanted, "reference", charts.REFERENCE, legend=not k)
        charts.scaled(figure, 1 + k, [found, wanted], item.name, item, display)
    pairs = zip(rig.system.inputs, rig.actuators, strict=True)
    for j, (variable, actuator) in enumerate(pairs):
        row, shown = 1 + len(rig.display) + j, inputs[:, j]
        charts.line(figure, row, time, shown, "input", charts.INPUT, shape="hv", legend=not j)
        for bound in (actuator.low, actuator.high):
            if np.abs(bound) <= 2.0 * np.abs(shown).max():
                figure.add_hline(y=bound, line={"color": charts.BOUND, "width": 1, "dash": "dot"}, row=row, col=1)
        title = charts.titled(variable.name, variable.unit)
        figure.update_yaxes(title=title, row=row, col=1, secondary_y=False)
        figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)
    return charts.timed(figure, len(rows))


def _panels(rows: list[int]) -> tuple[Any, Any]:
    """The module of charts, which needs plotly, and panels of these heights."""
    with extra("report"):
        from hybrid_sysid_ros.extensions.shared.report import charts
    height = sum(rows) + 70
    return charts, charts.panels(heights=[row / sum(rows) for row in rows], height=height)
