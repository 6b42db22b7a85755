"""Figures of fuzzy models for reports."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hybrid_sysid_ros.extensions.fuzzy.memberships import memberships as memberships_at
from hybrid_sysid_ros.extensions.fuzzy.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.extensions.shared.report.charts import LINES, dress

MEMBERSHIP_POINTS = 201


def membership_figure(system: TakagiSugeno) -> go.Figure:
    """Of each rule, a panel a premise variable: along it, with the other ones at the rule's centre."""
    centres, widths, names = system.centres, system.widths, [system.regressors[j] for j in system.premises]
    figure = make_subplots(rows=1, cols=len(names), horizontal_spacing=0.06)
    dress(figure, 260)
    for column, (name, (low, high)) in enumerate(zip(names, system.premise_ranges, strict=True)):
        along = np.linspace(low, high, MEMBERSHIP_POINTS)
        for rule, centre in enumerate(centres):
            points = np.tile(centre, (len(along), 1))
            points[:, column] = along
            figure.add_trace(
                go.Scatter(
                    x=along, y=memberships_at(points, centres, widths)[:, rule], name=f"rule {rule + 1}",
                    legendgroup=str(rule), showlegend=column == 0, mode="lines",
                    line={"color": LINES[rule % len(LINES)], "width": 1.6}, hovertemplate="%{y:.3f}",
                ), 1, column + 1,
            )  # fmt: skip
        figure.update_xaxes(title=str(name), row=1, col=column + 1)
    figure.update_yaxes(title="membership", range=[0.0, 1.02], row=1, col=1)
    return figure
