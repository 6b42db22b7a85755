"""Figures of an accuracy."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import stats

from hybrid_sysid_ros.extensions.accuracy.statistics import Accuracy, NormalInverseWishart, mean_width, spread_width
from hybrid_sysid_ros.extensions.accuracy.statistics.estimate import fewest
from hybrid_sysid_ros.extensions.shared.report.charts import (
    BOUND,
    MEASURED,
    MODEL,
    REFERENCE,
    dress,
    line,
    logarithmic,
    panels,
)
from hybrid_sysid_ros.support.arrays import Array

AHEAD = 2.0
"""How far the widths of intervals are predicted, as a multiple of the live shots."""
SHOWN = 500
"""Shots of a kind in a plot of their order, besides outliers."""


def impacts(found: Accuracy) -> go.Figure:
    """Shots over the first two coordinates, and the regions in which the mean is: by live shots alone and by both."""
    figure = go.Figure()
    dress(figure, 560)
    for shots, name, colour, size in (
        (found.simulated, "simulated", REFERENCE, 4),
        (found.live, "live", MEASURED, 8),
    ):
        dots = {"color": colour, "size": size}
        figure.add_trace(go.Scatter(x=shots.values[:, 0], y=shots.values[:, 1], mode="markers", name=name, marker=dots))
    for estimate, name, colour in (
        (found.live_only, "mean, live alone", MEASURED),
        (found.joint, "mean, together", MODEL),
    ):
        x, y = _mean_region(estimate.posterior, found.level)
        figure.add_trace(go.Scatter(x=x, y=y, mode="lines", name=name, line={"color": colour}))
    circle = found.joint.circular_error
    if circle is not None:
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        centre = found.joint.posterior.centre
        x, y = centre[0] + circle.value * np.cos(turn), centre[1] + circle.value * np.sin(turn)
        dotted = {"color": MODEL, "dash": "dot"}
        figure.add_trace(go.Scatter(x=x, y=y, mode="lines", name="circular error probable", line=dotted))
        figure.update_xaxes(constrain="domain")
        figure.update_yaxes(scaleanchor="x")
    pairs = zip(found.live.names, found.live.units, strict=True)
    labels = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
    figure.update_xaxes(title=labels[0])
    figure.update_yaxes(title=labels[1])
    figure.update_layout(hovermode="closest")
    return figure


def sequence(found: Accuracy, coordinate: int) -> go.Figure:
    """Widths of the intervals of a coordinate's mean and spread, as the shots came and as they are predicted."""
    figure = panels(heights=[0.5, 0.5], height=460)
    shots, level = found.live.values, found.level
    nothing = NormalInverseWishart.reference(shots.shape[1]).of_each_alone
    counts = np.arange(fewest(shots.shape[1]), len(shots) + 1)
    further = np.unique(np.linspace(0, max(AHEAD * len(shots), 10.0), 40).astype(int))
    for row, width in enumerate((mean_width, spread_width), 1):
        widths = []
        for prior, name, colour in ((nothing, "live alone", MEASURED), (found.prior, "together", MODEL)):
            curve = [width(prior.updated(shots[:count]), coordinate, 0, level, 0.5) for count in counts]
            widths += curve
            line(figure, row, counts.astype(float), np.array(curve), name, colour, legend=row == 1)
            posterior = prior.updated(shots)
            ahead = [width(posterior, coordinate, int(more), level, 0.5) for more in further]
            widths += ahead
            line(figure, row, len(shots) + further.astype(float), np.array(ahead), f"{name}, predicted", colour,
                 width=0.7, legend=row == 1)  # fmt: skip
        figure.update_yaxes(type="log", row=row, col=1, **logarithmic(min(widths), max(widths)))
    unit = found.live.units[coordinate]
    for row, name in enumerate(("mean", "spread"), 1):
        figure.update_yaxes(title=f"width, {name}{f' [{unit}]' if unit else ''}", row=row, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    figure.update_xaxes(title="live shots", row=2, col=1)
    return figure


def assumed(found: Accuracy, coordinate: int) -> go.Figure:
    """A coordinate in the order of the shots, and over the quantiles of a normal distribution, live above simulated;
    outliers are marked.
    """
    figure = make_subplots(
        rows=2, cols=2, column_widths=[0.6, 0.4], vertical_spacing=0.14, horizontal_spacing=0.1,
        column_titles=["in the order of the shots", "against a normal distribution"],
    )  # fmt: skip
    dress(figure, 440)
    figure.update_layout(margin_t=64)
    unit = found.live.units[coordinate]
    for row, (part, colour) in enumerate(zip(found.assumptions, (MEASURED, REFERENCE), strict=True), start=1):
        values = part.shots.values[:, coordinate]
        shown = np.unique(np.r_[np.arange(0, len(values), max(1, len(values) // SHOWN)), part.outliers].astype(int))
        outside = np.isin(shown, part.outliers)
        kept = np.delete(values, part.outliers)
        quantiles = stats.norm.ppf((stats.rankdata(values, method="ordinal") - 0.375) / (len(values) + 0.25))
        marker = {"color": np.where(outside, BOUND, colour), "size": np.where(outside, 10, 5)}
        for column, x in ((1, shown + 1), (2, quantiles[shown])):
            dots = go.Scatter(x=x, y=values[shown], mode="markers", marker=marker, showlegend=False)
            figure.add_trace(dots, row=row, col=column)
        ends = np.array([quantiles.min(), quantiles.max()])
        normal = kept.mean() + kept.std(ddof=1) * ends
        straight = {"color": MODEL, "width": 1.2}
        figure.add_trace(go.Scatter(x=ends, y=normal, mode="lines", line=straight, showlegend=False), row=row, col=2)
        name = "live" if row == 1 else "simulated"
        figure.update_yaxes(title=f"{name}{f' [{unit}]' if unit else ''}", row=row, col=1)
    figure.update_xaxes(title="shot", row=2, col=1)
    figure.update_xaxes(title="quantile [standard deviations]", row=2, col=2)
    figure.update_layout(hovermode="closest")
    return figure


def _mean_region(posterior: NormalInverseWishart, level: float) -> tuple[Array, Array]:
    """Edge of the region of the first two coordinates' mean, an ellipse of Student's t."""
    free = posterior.marginal_degrees
    square = 2.0 * stats.f.ppf(level, 2, free) / (posterior.strength * free)
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    edge = np.linalg.cholesky(square * posterior.scale[:2, :2]) @ np.array([np.cos(turn), np.sin(turn)])
    return posterior.centre[0] + edge[0], posterior.centre[1] + edge[1]
