"""Figures of a replay."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.playback.comparison import Compared
from hybrid_sysid_ros.extensions.shared.report.charts import ERROR, MEASURED, MINUS, MODEL, line, panels, timed


def both(number: Compared) -> go.Figure:
    """A number as it was recorded and as it was replayed, and their difference below."""
    figure = panels(heights=[0.67, 0.33], height=330)
    line(figure, 1, number.time, number.recorded, "recorded", MEASURED)
    line(figure, 1, number.time, number.replayed, "replayed", MODEL)
    difference = np.where(np.isfinite(number.difference), number.difference, np.nan)
    line(figure, 2, number.time, difference, f"replayed {MINUS} recorded", ERROR, legend=False)
    unit = f" [{number.unit}]" if number.unit else ""
    figure.update_yaxes(title=f"{number.field}{unit}", row=1, col=1, secondary_y=False)
    figure.update_yaxes(title="difference", exponentformat="power", row=2, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    return timed(figure, 2)
