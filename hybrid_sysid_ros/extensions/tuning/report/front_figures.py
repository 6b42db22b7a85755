"""Figures of a tuning."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hybrid_sysid_ros.extensions.shared.report.charts import BOUND, INPUT, MEASURED, MODEL, REFERENCE, dress
from hybrid_sysid_ros.extensions.tuning.front import TuningTrial


def front(trials: Sequence[TuningTrial], best_ones: Sequence[TuningTrial], best: TuningTrial) -> go.Figure:
    """All trials by both measures, the front among them, what ships and the best."""
    figure = go.Figure()
    marks = (
        ("trials", trials, REFERENCE, "markers", 6, "circle"),
        ("front", best_ones, MEASURED, "lines+markers", 7, "circle"),
        ("what ships", trials[:1], BOUND, "markers", 12, "x"),
        ("best by the aim", [best], MODEL, "markers", 13, "star"),
    )
    for name, some, color, mode, size, symbol in marks:
        figure.add_trace(
            go.Scatter(
                x=[trial.measures.effort for trial in some],
                y=[trial.measures.settling for trial in some],
                text=[f"trial {trial.number}, {trial.measures.inside:.0%} inside" for trial in some],
                mode=mode,
                name=name,
                line={"color": color, "shape": "hv"},
                marker={"color": color, "size": size, "symbol": symbol},
            )
        )
    dress(figure, 420)
    figure.update_layout(hovermode="closest")
    figure.update_xaxes(title="effort: changes of the inputs, rms, in shares of half their range", type="log")
    figure.update_yaxes(title="settling: mean error, in shares of the amplitude", type="log")
    return figure


def varied(trials: Sequence[TuningTrial], best_ones: Sequence[TuningTrial]) -> go.Figure:
    """Settling over what was varied, a panel each."""
    names, chosen = list(trials[0].options), {trial.number for trial in best_ones}
    figure = make_subplots(rows=len(names), cols=1, vertical_spacing=0.3 / len(names))
    for row, name in enumerate(names, start=1):
        for label, color, some in (
            ("trials", REFERENCE, [trial for trial in trials if trial.number not in chosen]),
            ("front", INPUT, best_ones),
        ):
            figure.add_trace(
                go.Scatter(
                    x=[trial.options[name] for trial in some],
                    y=[trial.measures.settling for trial in some],
                    mode="markers",
                    name=label,
                    showlegend=row == 1,
                    marker={"color": color, "size": 6},
                ),
                row=row,
                col=1,
            )
    dress(figure, 210 * len(names))
    figure.update_layout(hovermode="closest")
    for row, name in enumerate(names, start=1):
        of = "" if name.endswith("horizon") else ", factor of what ships"
        figure.update_xaxes(title=name + of, type="linear" if name.endswith("horizon") else "log", row=row, col=1)
        figure.update_yaxes(title="settling", type="log", row=row, col=1)
    return figure
