"""Figures of errors and bands over the horizon."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.horizon_bands.horizon_bands import HorizonBands
from hybrid_sysid_ros.extensions.shared.report.charts import ERROR, area, dress, line, logarithmic, panels, titled
from hybrid_sysid_ros.rigs.rig import Rig


def over_horizon(found: HorizonBands, rig: Rig) -> go.Figure:
    """Over the time ahead, a panel for each output: bands, and the half and 90 % of the errors of a record."""
    count = len(rig.display)
    height = 120 + 200 * count
    figure = panels(heights=[1.0] * count, height=height)
    for k, (item, display) in enumerate(zip(rig.system.outputs, rig.display, strict=True)):
        for level, half in sorted(found.halves.items(), reverse=True):
            wide = display.shown(half[:, k])
            area(figure, k + 1, found.seconds, -wide, wide, f"{level:.0%} band", legend=not k)
            for side in (-1.0, 1.0):
                quantile = np.quantile(found.errors[:, :, k], 0.5 + 0.5 * side * level, axis=0)
                name = f"middle {level:.0%} of the errors"
                width = 1.8 if level > 0.5 else 0.9
                shown = display.shown(quantile)
                line(figure, k + 1, found.seconds, shown, name, ERROR, width=width, legend=not k and side > 0.0)
        figure.update_yaxes(title=titled(item.name, display.unit), row=k + 1, col=1, secondary_y=False)
    figure.update_xaxes(type="log", **logarithmic(float(found.seconds[0]), float(found.seconds[-1])))
    figure.update_xaxes(title=f"time ahead [s], {found.name}", row=count, col=1)
    figure.update_yaxes(visible=False, secondary_y=True)
    dress(figure, height)
    return figure
