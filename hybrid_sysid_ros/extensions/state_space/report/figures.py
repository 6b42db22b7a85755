"""Figures of state-space models for reports."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.shared.report.charts import BOUND, MEASURED, dress
from hybrid_sysid_ros.extensions.state_space.state_space import StateSpace


def order_figure(system: StateSpace) -> go.Figure:
    """Error in held-out blocks over the order, with its standard error; the chosen order is marked."""
    orders, errors, spreads = np.array(system.trials).T
    figure = go.Figure()
    dress(figure, 280)
    figure.add_trace(
        go.Scatter(
            x=orders, y=100.0 * errors, error_y={"array": 100.0 * spreads, "thickness": 1}, mode="lines+markers",
            name="held-out blocks", line={"color": MEASURED, "width": 1.4}, hovertemplate="%{y:.3g} %",
        )
    )  # fmt: skip
    at = int(np.flatnonzero(orders == system.order)[0])
    figure.add_trace(
        go.Scatter(
            x=orders[at : at + 1], y=100.0 * errors[at : at + 1], mode="markers", name="chosen",
            marker={"color": BOUND, "size": 11, "symbol": "circle-open", "line": {"width": 2}},
            hovertemplate="%{y:.3g} %",
        )
    )  # fmt: skip
    figure.update_xaxes(title="order")
    figure.update_yaxes(title="error [% of the output's deviation]", type="log")
    return figure
