"""Figures of friction over speed."""

from __future__ import annotations

from collections.abc import Mapping

import plotly.graph_objects as go

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.friction_atlas.friction_curve import FrictionCurve
from hybrid_sysid_ros.extensions.shared.report.charts import LINES, dress


def friction(curves: Mapping[str, FrictionCurve], velocity: Variable, item: Variable) -> go.Figure:
    """Friction over a velocity by the models' names, in units of an input."""
    figure = go.Figure()
    dress(figure, 300)
    for colour, (name, curve) in zip(LINES, curves.items(), strict=False):
        line = {"color": colour, "width": 1.8}
        figure.add_scatter(x=curve.speeds, y=curve.inputs, name=name, mode="lines", line=line, hovertemplate="%{y:.4f}")
    figure.update_xaxes(title=f"{velocity.name} [{velocity.unit}]")
    figure.update_yaxes(title=f"{item.name} [{item.unit}]", rangemode="tozero")
    return figure
