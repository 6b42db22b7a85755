"""Charts: common parts of all figures. A colour has the same meaning in all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.shared.residual_tests import ResidualTest
from hybrid_sysid_ros.rigs.sensor import Display
from hybrid_sysid_ros.support.arrays import Array

MEASURED, MODEL, REFERENCE, INPUT, ERROR, BOUND = "#1f4e79", "#e8710a", "#8b95a1", "#2e7d4f", "#7b4fa3", "#c0392b"
BAND = "rgba(232,113,10,.16)"
LINES = ("#1f4e79", "#e8710a", "#2e7d4f", "#7b4fa3", "#c0392b", "#0f8b8d", "#a67c00", "#6b7683")
"""Colours of several records or structures in one figure."""
TEXT, GRID = "#2b3440", "#e6e9ed"
FONT = {
    "family": "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif",
    "size": 12,
    "color": TEXT,
}
MINUS = "\N{MINUS SIGN}"
LONG_NAME = 12  # letters
POINTS = 16_000  # most points of a line
FEW_TICKS, MANY_DECADES = 2, 3  # ticks and decades of a logarithmic axis


def panels(*, heights: Sequence[float], height: int) -> go.Figure:
    """Panels above one another with a common time axis, each with a second axis at the right."""
    figure = make_subplots(
        rows=len(heights),
        cols=1,
        shared_xaxes=True,
        row_heights=list(heights),
        vertical_spacing=0.035,
        specs=[[{"secondary_y": True}]] * len(heights),
    )
    dress(figure, height)
    figure.update_xaxes(domain=[0.0, 1.0])
    return figure


def dress(figure: go.Figure, height: int) -> None:
    """Apply the common style of all figures."""
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


def timed(figure: go.Figure, rows: int) -> go.Figure:
    """Add the time axis below the last row."""
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4}, row=rows, col=1)
    return figure


def line(
    figure: go.Figure, row: int, x: Array, y: Array, name: str, colour: str, *, width: float = 1.2, legend: bool = True,
    shape: str = "linear",
) -> None:  # fmt: skip
    """Draw a line over time in a row of panels."""
    line = {"color": colour, "width": width, "shape": shape}
    template = "%{y:.3f}"
    trace = go.Scatter(**data(x, y), mode="lines", name=name, line=line, showlegend=legend, hovertemplate=template)
    figure.add_trace(trace, row=row, col=1, secondary_y=False)


def area(figure: go.Figure, row: int, x: Array, low: Array, high: Array, name: str, *, legend: bool = True) -> None:
    """Shade what lies between two lines over time in a row of panels."""
    shared: dict[str, Any] = {
        "mode": "lines",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "legendgroup": f"{name} {row}",
    }
    figure.add_trace(go.Scatter(**data(x, low), **shared, showlegend=False), row=row, col=1, secondary_y=False)
    filled = go.Scatter(**data(x, high), **shared, name=name, showlegend=legend, fill="tonexty", fillcolor=BAND)
    figure.add_trace(filled, row=row, col=1, secondary_y=False)


def second_scale(output: Variable, display: Display) -> tuple[str, float] | None:
    """A second unit for an output, and its value per display unit; angles in degrees.

    None where there is no second unit.
    """
    angle = output.unit.startswith("rad")
    unit = output.unit.replace("rad", "°", 1) if angle else output.unit
    scale = math.degrees(display.scale) if angle else display.scale
    return None if unit == display.unit.replace("deg", "°", 1) or not unit else (unit, scale)


def titled(name: str, unit: str) -> str:
    """Title of an axis: a name and its unit, on two lines where the name is long."""
    return f"{name}{'<br>' if len(name) > LONG_NAME else ' '}[{unit}]"


def logarithmic(low: float, high: float) -> dict[str, list[float] | list[str]]:
    """Ticks of a logarithmic axis: 1, 2 and 5 of each decade, only 1 of many decades, and the ends of a short axis."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = np.array([1.0] if last - first > MANY_DECADES else [1.0, 2.0, 5.0])
    values = np.concatenate([steps * 10.0**k for k in range(first, last + 1)])
    inside = values[(values >= low) & (values <= high)]
    if len(inside) < FEW_TICKS:
        inside = np.linspace(low, high, FEW_TICKS)
    return {"tickvals": inside.tolist(), "ticktext": [f"{value:.3g}" for value in inside]}


def scaled(
    figure: go.Figure, row: int, values: Sequence[Array], name: str, output: Variable, display: Display,
    *, symmetric: bool = False,
) -> None:  # fmt: skip
    """Set one range for both axes of a panel: the display unit at the left, the second unit at the right."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
    if symmetric:
        low, high = -max(-low, high), max(-low, high)
    margin = max(0.06 * (high - low), 1e-6)
    low, high = low - margin, high + margin
    axis = {"fixedrange": True, "row": row, "col": 1, "nticks": 6}  # two axes can only be zoomed apart
    title = titled(name, display.unit or "1")
    figure.update_yaxes(title=title, range=[low, high], secondary_y=False, **axis)
    second = second_scale(output, display)
    if second is None:
        figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)
        return
    hidden = go.Scatter(x=[None], y=[None], showlegend=False, hoverinfo="skip")
    figure.add_trace(hidden, row=row, col=1, secondary_y=True)  # an axis without a line is not drawn
    unit, scale = second
    other = {"range": [scale * low, scale * high], "showgrid": False, "zeroline": False}
    figure.update_yaxes(title=f"[{unit}]", secondary_y=True, **axis, **other)


def stems(test: ResidualTest, period: float) -> tuple[go.Bar, dict[str, Any], tuple[float, float]]:
    """Coefficients over their lags as bars, with another colour beyond the bounds; the area of the bounds as a shape;
    and the range that shows both.
    """
    colours = np.where(np.abs(test.values) > test.bound, BOUND, ERROR).tolist()
    bars = go.Bar(
        **data(np.asarray(period * test.lags), test.values), marker={"color": colours, "line": {"width": 0}},
        width=0.55 * period, hovertemplate="lag %{x:.2f} s: %{y:.3f}<extra></extra>",
    )  # fmt: skip
    area = {
        "type": "rect", "x0": 0, "x1": 1, "y0": -test.bound, "y1": test.bound,
        "fillcolor": REFERENCE, "opacity": 0.22, "line": {"width": 0}, "layer": "below",
    }  # fmt: skip
    span = 1.1 * max(float(np.max(np.abs(test.values))), 1.4 * test.bound)
    return bars, area, (-span, span)


def data(x: Array, y: Array) -> dict[str, Any]:
    """The data of a line, with as many points and digits as a browser can show."""
    stride = max(1, -(-len(x) // POINTS))
    return {"x": x[::stride].astype(np.float32), "y": y[::stride].astype(np.float32)}
