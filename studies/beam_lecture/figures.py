"""Figures of a protocol."""

from __future__ import annotations

import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.shared.report.charts import MEASURED, MINUS, MODEL, REFERENCE, dress
from studies.beam_lecture.report import ProtocolSection

FLOOR = 1e-4  # of 1 - R2


def scores(section: ProtocolSection) -> go.Figure:
    """1 - R2 of every structure on every record: the pick with its range over seeds, others in grey."""
    figure = go.Figure()
    dress(figure, 360)
    records, pick = section.records, section.pick
    others = [result for result in section.results if not result.chosen]
    for result in others:
        figure.add_trace(
            go.Scatter(
                x=records, y=[_left(result.mean[name]) for name in records], mode="markers", name="other structures",
                legendgroup="others", showlegend=result is others[0], text=[result.name] * len(records),
                marker={"color": REFERENCE, "size": 8, "opacity": 0.55},
                hovertemplate="%{text}: %{y:.4f}<extra></extra>",
            )
        )  # fmt: skip
    published = [result.published for result in section.results if result.published]
    best = {
        name: max(row[name] for row in published if name in row)
        for name in records
        if any(name in r for r in published)
    }
    if best:
        figure.add_trace(
            go.Scatter(
                x=list(best), y=[_left(value) for value in best.values()], mode="markers", name="best published",
                marker={"color": MEASURED, "size": 11, "symbol": "diamond-open", "line": {"width": 2}},
                hovertemplate="published: %{y:.4f}<extra></extra>",
            )
        )  # fmt: skip
    if pick is not None:
        means = [_left(pick.mean[name]) for name in records]
        ends = [pick.range[name] for name in records]
        figure.add_trace(
            go.Scatter(
                x=records, y=means, mode="markers", name=pick.name, marker={"color": MODEL, "size": 11},
                error_y={
                    "type": "data", "symmetric": False, "color": MODEL, "thickness": 1.5, "width": 5,
                    "array": [_left(low) - mean for (low, _), mean in zip(ends, means, strict=True)],
                    "arrayminus": [mean - _left(high) for (_, high), mean in zip(ends, means, strict=True)],
                },
                hovertemplate=f"{pick.name}: %{{y:.4f}}<extra></extra>",
            )
        )  # fmt: skip
    figure.update_yaxes(type="log", dtick="D2", title=f"1 {MINUS} R²  (lower is better)")
    figure.update_xaxes(categoryorder="array", categoryarray=records)
    figure.update_layout(hovermode="closest", margin={"t": 50}, legend={"y": 1.02})
    return figure


def _left(r2: float) -> float:
    """What a simulation leaves, as far down as the axis goes."""
    return max(1.0 - r2, FLOOR)
