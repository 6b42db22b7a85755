"""Figures of forecast loops with their bands."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.loop_bands.loop_bands import LoopBands
from hybrid_sysid_ros.extensions.shared.report.charts import MEASURED, MODEL, POINTS, area, dress, line, panels, titled
from hybrid_sysid_ros.rigs.rig import Rig

HEIGHT = 320


def over_time(found: LoopBands, rig: Rig) -> go.Figure:
    """Forecast, measurement and bands of a record over time, in the output's display unit."""
    figure, display = panels(heights=[1.0], height=HEIGHT), rig.display[0]
    every = max(1, len(found.time) // POINTS)
    time, run = found.time[::every], found.forecast[::every]
    for level, half in sorted(found.halves.items(), reverse=True):
        low, high = (np.asarray(display.shown(run + side * half[::every])) for side in (-1.0, 1.0))
        area(figure, 1, time, low, high, f"{level:.0%} band")
    line(figure, 1, time, display.shown(found.measured[::every]), "measured", MEASURED)
    line(figure, 1, time, display.shown(run), "forecast", MODEL)
    figure.update_yaxes(title=titled(rig.system.outputs[0].name, display.unit), row=1, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    figure.update_xaxes(title=f"time [s], {found.name}", row=1, col=1)
    dress(figure, HEIGHT)
    return figure
