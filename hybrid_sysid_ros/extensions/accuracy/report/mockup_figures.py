"""Figures of a mock-up."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hybrid_sysid_ros.extensions.accuracy.verdict import Found
from hybrid_sysid_ros.extensions.shared.report.charts import (
    INPUT,
    LINES,
    MEASURED,
    REFERENCE,
    dress,
    line,
    panels,
    scaled,
    timed,
    titled,
)
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

POINTS = 400  # of a distribution at most


def tracking_errors(found: Found) -> go.Figure:
    """Distributions of the misses, a panel for each part of the reference, a line for each kind of shots."""
    windows = next(iter(found.runs.values())).windows
    figure = make_subplots(rows=1, cols=len(windows), horizontal_spacing=0.08)
    dress(figure, 360)
    for k, (window, unit) in enumerate(windows.items(), start=1):
        for colour, (name, runs) in zip(LINES, found.runs.items(), strict=False):
            values = np.sort(runs.tracking_error[np.isfinite(runs.tracking_error[:, k - 1]), k - 1])
            values = values[:: max(1, len(values) // POINTS)]
            shares = (np.arange(len(values)) + 0.5) / max(len(values), 1)
            steps = {"color": colour, "shape": "hv", "width": 2.4 if name == "live" else 1.3}
            trace = go.Scatter(x=values, y=shares, mode="lines", name=name, line=steps, showlegend=k == 1)
            figure.add_trace(trace, row=1, col=k)
        figure.update_xaxes(title=f"{window}: miss [{unit or '1'}]", row=1, col=k)
    figure.update_yaxes(title="share of the shots below", col=1)
    figure.update_layout(hovermode="closest")
    return figure


def tracking(found: Found) -> go.Figure:
    """Each followed output with its reference, and the inputs with their bounds."""
    rig, loop = found.setup.rig, found.loop
    references = loop.reference if isinstance(loop, LoopRecord) else loop.references
    followed = sorted({segment.output for segment in found.runs["live"].where.schedule.segments})
    weights = [0.5] * len(followed) + [0.34] * len(rig.actuators)
    figure = panels(heights=[weight / sum(weights) for weight in weights], height=round(460 * sum(weights)))
    for row, k in enumerate(followed, start=1):
        output, display = rig.system.outputs[k], rig.display[k]
        reached, wanted = display.shown(loop.outputs[:, k]), display.shown(references[:, k])
        line(figure, row, loop.time, reached, "reached", MEASURED, legend=row == 1)
        line(figure, row, loop.time, wanted, "reference", REFERENCE, width=1.4, legend=row == 1)
        scaled(figure, row, [reached, wanted], output.name, output, display)
    for row, (item, actuator) in enumerate(zip(rig.system.inputs, rig.actuators, strict=True), start=len(followed) + 1):
        j = row - len(followed) - 1
        line(figure, row, loop.time, loop.inputs[:, j], "input", INPUT, legend=j == 0, shape="hv")
        for level in (actuator.low, actuator.high):
            figure.add_hline(y=level, line={"color": REFERENCE, "dash": "dot", "width": 1}, row=row, col=1)
        figure.update_yaxes(title=titled(item.name, item.unit), row=row, col=1, secondary_y=False)
        figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)
    return timed(figure, len(weights))
