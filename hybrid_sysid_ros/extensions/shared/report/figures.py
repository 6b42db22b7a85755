"""Figures of free runs: over time, tests of their residuals, and errors over the horizon."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hybrid_sysid_ros.extensions.shared.horizons import HorizonErrors
from hybrid_sysid_ros.extensions.shared.report import charts
from hybrid_sysid_ros.extensions.shared.report.sections import FreeRunSection, IdentificationSection
from hybrid_sysid_ros.rigs.sensor import Display

LABEL = 20
"""Most characters beside a low panel."""

FREE_RUN_AT = 2.2
"""Abscissa of the free run's value, in longest horizons."""


def free_run(run: FreeRunSection) -> go.Figure:
    """Measured and simulated output above, their difference below."""
    figure, display = charts.panels(heights=[0.67, 0.33], height=330), run.display
    measured, simulated = display.shown(run.measured), display.shown(run.simulated)
    for level, half in sorted(run.bands.items(), reverse=True):
        width, name = display.shown(half), f"{level:.0%} band"
        nominal = np.interp(run.residual_time, run.simulated_time, simulated)
        charts.area(figure, 1, run.residual_time, nominal - width, nominal + width, name)
        charts.area(figure, 2, run.residual_time, -width, width, name, legend=False)
    charts.line(figure, 1, run.time, measured, "measured", charts.MEASURED)
    charts.line(figure, 1, run.simulated_time, simulated, run.kind, charts.MODEL)
    residuals = display.shown(run.residuals)
    charts.line(
        figure, 2, run.residual_time, residuals, f"measured {charts.MINUS} {run.kind}", charts.ERROR, legend=False
    )
    charts.scaled(figure, 1, [measured, simulated], run.output.name, run.output, display)
    charts.scaled(figure, 2, [residuals], "residual", run.output, display, symmetric=True)
    return charts.timed(figure, 2)


def residual_tests(section: IdentificationSection) -> go.Figure:
    """Residual tests with a row for each record and a column for each test; grey bands are the bounds."""
    runs, columns = section.runs, section.tests
    figure = make_subplots(
        rows=len(runs),
        cols=len(columns),
        column_titles=list(columns.values()),
        horizontal_spacing=0.035,
        vertical_spacing=0.2 / max(len(runs), 2),
    )
    period, shapes = section.model.sampling.period, list[dict[str, Any]]()
    places = [(row, column) for row in range(len(runs)) for column in range(len(columns))]
    for place, (row, column) in enumerate(places, start=1):
        run, name = runs[row], list(columns)[column]
        axis = figure.layout[f"yaxis{place}"]
        if name in run.tests:
            bars, area, axis.range = charts.stems(run.tests[name], period)
            figure.add_trace(bars, row=1 + row, col=1 + column)
            drawn = figure.data[-1]
            shapes.append({**area, "xref": f"{drawn.xaxis} domain", "yref": drawn.yaxis})
        if not column:
            axis.title = {"text": _beside(run, section.model.rig), "font": {"size": 10}, "standoff": 4}
    figure.update_layout(shapes=shapes)  # at once, since plotly looks through all of them for each that is added
    charts.dress(figure, 100 + 118 * len(runs))
    figure.update_xaxes(showticklabels=True, nticks=5, tickfont={"size": 9})
    figure.update_yaxes(nticks=4, tickfont={"size": 9})
    figure.update_xaxes(title={"text": "lag [s]", "standoff": 4}, row=len(runs))
    figure.update_layout(showlegend=False, margin={"l": 74, "r": 12, "t": 50, "b": 44})
    figure.update_annotations(font={"size": 12, "color": charts.TEXT})
    return figure


def _beside(run: FreeRunSection, rig: str) -> str:
    """Name of a run beside a low panel, shortened: the record above the output."""
    record, _, output = run.name.removeprefix(f"{rig}_").partition(", ")
    parts = (part if len(part) <= LABEL else f"{part[: LABEL - 1]}…" for part in (record, output) if part)
    return "<br>".join(parts)


def horizons(lines: Sequence[HorizonErrors], display: Display) -> go.Figure:
    """RMSE and 1 - R2 over the horizon, both logarithmic; points at the right belong to the whole record."""
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.09)
    charts.dress(figure, 380)
    longest = max(float(item.seconds[-1]) for item in lines)
    end = FREE_RUN_AT * longest
    for number, item in enumerate(lines):
        colour, dash = charts.LINES[number % len(charts.LINES)], "solid" if number < len(charts.LINES) else "dot"
        rmse = display.shown(item.rmse), float(display.shown(np.float64(item.free_run.rmse)))
        for column, (curve, limit) in enumerate((rmse, (1.0 - item.r2, 1.0 - item.free_run.r2)), start=1):
            figure.add_trace(
                go.Scatter(
                    x=item.seconds, y=np.where(np.isfinite(curve), curve, np.nan), name=item.name,
                    legendgroup=item.name, showlegend=column == 1, mode="lines",
                    line={"color": colour, "width": 1.8, "dash": dash},
                    hovertemplate="%{y:.4f}",
                ), 1, column,
            )  # fmt: skip
            if np.isfinite(limit):
                figure.add_trace(
                    go.Scatter(
                        x=[item.seconds[-1], end], y=[curve[-1], limit], legendgroup=item.name, showlegend=False,
                        mode="lines+markers", line={"color": colour, "width": 1, "dash": "dot"}, name=item.name,
                        marker={"size": [0, 7]}, hovertemplate="%{y:.4f}",
                    ), 1, column,
                )  # fmt: skip
    first = min(float(item.seconds[0]) for item in lines)
    ticks = [t for t in (0.01, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if first <= t <= longest]
    for column in (1, 2):
        figure.update_xaxes(
            type="log", tickvals=[*ticks, end], ticktext=[*(f"{t:g}" for t in ticks), "whole run"],
            title="horizon [s]", row=1, col=column,
        )  # fmt: skip
    for column, title in ((1, f"RMSE [{display.unit}]"), (2, f"1 {charts.MINUS} R²")):
        shown = np.concatenate([np.asarray(trace.y, dtype=float) for trace in figure.select_traces(col=column)])
        shown = shown[np.isfinite(shown) & (shown > 0.0)]
        axis = charts.logarithmic(float(shown.min()), float(shown.max())) if len(shown) else {}
        figure.update_yaxes(title=title, type="log", tickfont={"size": 11}, row=1, col=column, **axis)
    figure.update_layout(legend={"y": 1.02}, margin={"t": 70}, hovermode="closest")
    return figure
