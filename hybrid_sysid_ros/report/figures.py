"""Figures: what the sections tell, drawn. One colour means one thing in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from hybrid_sysid_ros.identification.residual_tests import ResidualTest
from hybrid_sysid_ros.loop import LoopRecord
from hybrid_sysid_ros.report.sections import ClosedLoopSection, FreeRun, IdentificationSection
from hybrid_sysid_ros.rigs.sensor import Sensor

Array = NDArray[np.float64]

MEASURED, MODEL, REFERENCE, INPUT, ERROR, BOUND = "#1f4e79", "#e8710a", "#8b95a1", "#2e7d4f", "#7b4fa3", "#c0392b"
TEXT, GRID = "#2b3440", "#e6e9ed"
FONT = {
    "family": "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif",
    "size": 12,
    "color": TEXT,
}
MINUS = "\N{MINUS SIGN}"
POINTS = 16_000  # of a line at most
TAIL_POINTS = 600  # of a distribution at most


def free_run(run: FreeRun, sensor: Sensor) -> go.Figure:
    """Measured and simulated output above, their difference below; volts at the left, degrees at the right."""
    figure = _panels(heights=[0.67, 0.33], height=330)
    measured, simulated = sensor.volts(run.measured), sensor.volts(run.simulated)
    _line(figure, 1, run.time, measured, "measured", MEASURED)
    _line(figure, 1, run.simulated_time, simulated, "free run", MODEL)
    residuals = sensor.volts(run.residuals)
    _line(figure, 2, run.residual_time, residuals, f"measured {MINUS} free run", ERROR, legend=False)
    _volts_and_degrees(figure, 1, [measured, simulated], "output", sensor)
    _volts_and_degrees(figure, 2, [residuals], "residual", sensor, symmetric=True)
    return _timed(figure, 2)


def residual_tests(section: IdentificationSection) -> go.Figure:
    """A row a record: autocorrelation of the residuals, cross-correlation with the input and with the reference."""
    runs = section.runs
    kinds = [("white", "residual with itself"), ("against_input", "residual with input"),
             ("against_reference", "residual with reference")]  # fmt: skip
    kinds = [kind for kind in kinds if any(getattr(run, kind[0]) for run in runs)]
    figure = make_subplots(
        rows=len(runs),
        cols=len(kinds),
        column_titles=[title for _, title in kinds],
        horizontal_spacing=0.045,
        vertical_spacing=0.22 / max(len(runs), 2),
    )
    period = section.model.sampling.period
    for row, run in enumerate(runs, start=1):
        for column, (kind, _) in enumerate(kinds, start=1):
            test: ResidualTest | None = getattr(run, kind)
            if test is not None:
                _stems(figure, row, column, test, period)
        figure.update_yaxes(title={"text": run.name, "font": {"size": 10}, "standoff": 4}, row=row, col=1)
    _dress(figure, 100 + 132 * len(runs))
    figure.update_xaxes(showticklabels=True, tickfont={"size": 10})
    figure.update_yaxes(nticks=5, tickfont={"size": 10})
    figure.update_xaxes(title={"text": "lag [s]", "standoff": 4}, row=len(runs))
    figure.update_layout(showlegend=False, margin={"l": 62, "r": 12, "t": 50, "b": 44})
    figure.update_annotations(font={"size": 12, "color": TEXT})
    return figure


def tracking(section: ClosedLoopSection) -> go.Figure:
    """Position and reference, tracking error, input with its bounds."""
    loop, sensor = section.loop, section.rig.sensor
    figure = _panels(heights=[0.46, 0.24, 0.3], height=540)
    reference, position = sensor.volts(loop.reference), sensor.volts(loop.position)
    _line(figure, 1, loop.time, position, "measured", MEASURED)
    _line(figure, 1, loop.time, reference, "reference", REFERENCE, width=1.4)
    error = sensor.volts(loop.error)
    _line(figure, 2, loop.time, error, f"reference {MINUS} measured", ERROR, legend=False)
    _input(figure, 3, loop, section.rig.input_limit)
    _volts_and_degrees(figure, 1, [reference, position], "position", sensor)
    _volts_and_degrees(figure, 2, [error], "error", sensor, symmetric=True)
    for name, (start, stop) in section.windows.items():
        figure.add_annotation(
            x=(start + min(stop, loop.time[-1])) / 2, y=1.0, xref="x", yref="y domain", yanchor="bottom",
            text=f"{name}: RMSE {loop.tracking_rmse(start, stop):.3f} V", showarrow=False, font={"size": 12},
        )  # fmt: skip
    figure.update_layout(margin={"t": 48}, legend={"y": 1.05})
    return _timed(figure, 3)


def zoom(section: ClosedLoopSection, name: str) -> go.Figure:
    """Reference, position and input from one moment to another."""
    loop, sensor = section.loop, section.rig.sensor
    start, stop = section.zooms[name]
    inside = loop.within(start, stop)
    figure = _panels(heights=[0.62, 0.38], height=380)
    reference, position = sensor.volts(loop.reference)[inside], sensor.volts(loop.position)[inside]
    _line(figure, 1, loop.time[inside], position, "measured", MEASURED)
    _line(figure, 1, loop.time[inside], reference, "reference", REFERENCE, width=1.6)
    _input(figure, 2, loop, section.rig.input_limit, inside)
    _volts_and_degrees(figure, 1, [reference, position], "position", sensor)
    return _timed(figure, 2)


def delays(section: ClosedLoopSection) -> go.Figure:
    """Delay of every command over time, and how many are later than a delay."""
    loop = section.loop
    values = 1e3 * (loop.delay if loop.is_real_time else loop.turnaround)
    figure = make_subplots(rows=1, cols=2, column_widths=[0.6, 0.4], horizontal_spacing=0.09)
    running = loop.time >= 0.0
    time, values, late = loop.time[running], values[running], loop.late[running]
    figure.add_trace(go.Scatter(x=time, y=values, line={"color": MEASURED, "width": 0.9}, name="delay"), 1, 1)
    if late.any():
        figure.add_trace(
            go.Scatter(
                **_data(time[late], np.nan_to_num(values[late])), mode="markers", name="missed", cliponaxis=False,
                marker={"color": BOUND, "symbol": "x", "size": 8},
            ), 1, 1,
        )  # fmt: skip
    known = np.sort(values[np.isfinite(values)])
    if len(known):
        share = 100.0 * (1.0 - np.arange(len(known)) / len(known))
        chosen = np.unique(np.geomspace(1, len(known), TAIL_POINTS).astype(int))
        chosen = len(known) - chosen[::-1]
        figure.add_trace(
            go.Scatter(**_data(known[chosen], share[chosen]), line={"color": MEASURED, "width": 1.6}), 1, 2
        )
        marks = (("p50", 50.0, np.percentile(known, 50)), ("p99", 1.0, np.percentile(known, 99)),
                 ("max", share[-1], known[-1]))  # fmt: skip
        for name, y, x in marks:
            figure.add_trace(
                go.Scatter(
                    x=[float(x)], y=[float(y)], mode="markers+text", text=[f"  {name} {x:.2f} ms"],
                    textposition="middle left" if name == "max" else "middle right", cliponaxis=False,
                    marker={"color": MODEL, "size": 7}, hoverinfo="skip",
                ), 1, 2,
            )  # fmt: skip
    _dress(figure, 320)
    figure.update_xaxes(title="time [s]", row=1, col=1)
    figure.update_yaxes(title="delay [ms]", rangemode="tozero", row=1, col=1)
    figure.update_xaxes(title="delay [ms]", rangemode="tozero", row=1, col=2)
    figure.update_yaxes(
        title="commands later [%]", type="log", tickvals=[100, 10, 1, 0.1, 0.01, 0.001],
        ticktext=["100", "10", "1", "0.1", "0.01", "0.001"], row=1, col=2,
    )  # fmt: skip
    figure.update_layout(showlegend=False)
    return figure


def _panels(*, heights: Sequence[float], height: int) -> go.Figure:
    """Panels above one another that share their time, each with a second axis at the right."""
    figure = make_subplots(
        rows=len(heights),
        cols=1,
        shared_xaxes=True,
        row_heights=list(heights),
        vertical_spacing=0.035,
        specs=[[{"secondary_y": True}]] * len(heights),
    )
    _dress(figure, height)
    figure.update_xaxes(domain=[0.0, 1.0])
    return figure


def _dress(figure: go.Figure, height: int) -> None:
    figure.update_layout(
        height=height,
        autosize=True,
        template="none",
        font=FONT,
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="#ffffff",
        margin={"l": 62, "r": 58, "t": 26, "b": 40},
        legend={"orientation": "h", "x": 0, "xanchor": "left", "y": 1.005, "yanchor": "bottom"},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": "#b6bdc7", "activecolor": MEASURED},
        hovermode="x unified",
        hoverlabel={"font": {"size": 12}},
        dragmode="zoom",
    )
    axis = {"gridcolor": GRID, "zerolinecolor": "#c9ced6", "zerolinewidth": 1, "linecolor": "#b6bdc7", "ticks": "",
            "showline": True, "mirror": False, "title": {"standoff": 6}}  # fmt: skip
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)


def _timed(figure: go.Figure, rows: int) -> go.Figure:
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4}, row=rows, col=1)
    return figure


def _line(
    figure: go.Figure, row: int, x: Array, y: Array, name: str, colour: str, *, width: float = 1.2, legend: bool = True,
    shape: str = "linear",
) -> None:  # fmt: skip
    line = {"color": colour, "width": width, "shape": shape}
    template = "%{y:.3f}"
    trace = go.Scatter(**_data(x, y), mode="lines", name=name, line=line, showlegend=legend, hovertemplate=template)
    figure.add_trace(trace, row=row, col=1, secondary_y=False)


def _input(
    figure: go.Figure, row: int, loop: LoopRecord, limit: float, inside: NDArray[np.bool_] | None = None
) -> None:
    chosen = np.ones(len(loop.time), dtype=bool) if inside is None else inside
    _line(figure, row, loop.time[chosen], loop.input[chosen], "input", INPUT, shape="hv", legend=False)
    for bound in (-limit, limit):
        figure.add_hline(y=bound, line={"color": BOUND, "width": 1, "dash": "dot"}, row=row, col=1)
    unit = loop.rig.equation.inputs[0].unit
    figure.update_yaxes(title=f"input [{unit}]", range=[-1.12 * limit, 1.12 * limit], row=row, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)


def _volts_and_degrees(
    figure: go.Figure, row: int, values: Sequence[Array], name: str, sensor: Sensor, *, symmetric: bool = False
) -> None:
    """One range for both axes of a panel: sensor volts at the left, degrees at the right."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
    if symmetric:
        low, high = -max(-low, high), max(-low, high)
    margin = max(0.06 * (high - low), 1e-6)
    low, high = low - margin, high + margin
    scale = float(np.degrees(sensor.radians_per_volt))
    hidden = go.Scatter(x=[None], y=[None], showlegend=False, hoverinfo="skip")
    figure.add_trace(hidden, row=row, col=1, secondary_y=True)  # an axis without a line is not drawn
    axis = {"fixedrange": True, "row": row, "col": 1, "nticks": 6}  # two axes can only be zoomed apart
    figure.update_yaxes(title=f"{name} [V]", range=[low, high], secondary_y=False, **axis)
    degrees = {"range": [scale * low, scale * high], "showgrid": False, "zeroline": False}
    figure.update_yaxes(title="[°]", secondary_y=True, **axis, **degrees)


def _stems(figure: go.Figure, row: int, column: int, test: ResidualTest, period: float) -> None:
    """Coefficients over their lags as bars, in the colour of an alarm beyond the bounds."""
    colours = np.where(np.abs(test.values) > test.bound, BOUND, ERROR).tolist()
    lags = np.asarray(period * test.lags)
    bars = go.Bar(
        **_data(lags, test.values), marker={"color": colours, "line": {"width": 0}}, width=0.55 * period,
        hovertemplate="lag %{x:.2f} s: %{y:.3f}<extra></extra>",
    )  # fmt: skip
    figure.add_trace(bars, row=row, col=column)
    figure.add_hrect(
        y0=-test.bound,
        y1=test.bound,
        fillcolor=REFERENCE,
        opacity=0.22,
        line_width=0,
        layer="below",
        row=row,
        col=column,
    )
    span = 1.1 * max(float(np.max(np.abs(test.values))), 1.4 * test.bound)
    figure.update_yaxes(range=[-span, span], row=row, col=column)


def _data(x: Array, y: Array) -> dict[str, Any]:
    """A line's data: no more points than a browser likes, no more digits than an eye sees."""
    stride = max(1, -(-len(x) // POINTS))
    return {"x": x[::stride].astype(np.float32), "y": y[::stride].astype(np.float32)}
