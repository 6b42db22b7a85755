"""Figures of a recorded loop."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from hybrid_sysid_ros.report.charts import (
    BOUND,
    ERROR,
    INPUT,
    MEASURED,
    MINUS,
    MODEL,
    REFERENCE,
    data,
    dress,
    line,
    panels,
    timed,
    volts_and_degrees,
)
from hybrid_sysid_ros.report.sections import ClosedLoopSection
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

TAIL_POINTS = 600  # of a distribution at most


def tracking(section: ClosedLoopSection) -> go.Figure:
    """Position and reference, tracking error, input with its bounds."""
    loop, display = section.loop, section.rig.display[0]
    figure = panels(heights=[0.46, 0.24, 0.3], height=540)
    reference, position = display.shown(loop.reference), display.shown(loop.position)
    line(figure, 1, loop.time, position, "measured", MEASURED)
    line(figure, 1, loop.time, reference, "reference", REFERENCE, width=1.4)
    error = display.shown(loop.error)
    line(figure, 2, loop.time, error, f"reference {MINUS} measured", ERROR, legend=False)
    _input(figure, 3, loop, section.rig.actuators[0].high)
    volts_and_degrees(figure, 1, [reference, position], "position", display)
    volts_and_degrees(figure, 2, [error], "error", display, symmetric=True)
    for name, (start, stop) in section.windows.items():
        figure.add_annotation(
            x=(start + min(stop, loop.time[-1])) / 2, y=1.0, xref="x", yref="y domain", yanchor="bottom",
            text=f"{name}: RMSE {loop.tracking_rmse(start, stop):.3f} V", showarrow=False, font={"size": 12},
        )  # fmt: skip
    figure.update_layout(margin={"t": 48}, legend={"y": 1.05})
    return timed(figure, 3)


def zoom(section: ClosedLoopSection, name: str) -> go.Figure:
    """Reference, position and input from one moment to another."""
    loop, display = section.loop, section.rig.display[0]
    start, stop = section.zooms[name]
    inside = loop.within(start, stop)
    figure = panels(heights=[0.62, 0.38], height=380)
    reference, position = display.shown(loop.reference)[inside], display.shown(loop.position)[inside]
    line(figure, 1, loop.time[inside], position, "measured", MEASURED)
    line(figure, 1, loop.time[inside], reference, "reference", REFERENCE, width=1.6)
    _input(figure, 2, loop, section.rig.actuators[0].high, inside)
    volts_and_degrees(figure, 1, [reference, position], "position", display)
    return timed(figure, 2)


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
                **data(time[late], np.nan_to_num(values[late])), mode="markers", name="missed", cliponaxis=False,
                marker={"color": BOUND, "symbol": "x", "size": 8},
            ), 1, 1,
        )  # fmt: skip
    known = np.sort(values[np.isfinite(values)])
    if len(known):
        share = 100.0 * (1.0 - np.arange(len(known)) / len(known))
        chosen = np.unique(np.geomspace(1, len(known), TAIL_POINTS).astype(int))
        chosen = len(known) - chosen[::-1]
        figure.add_trace(go.Scatter(**data(known[chosen], share[chosen]), line={"color": MEASURED, "width": 1.6}), 1, 2)
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
    dress(figure, 320)
    figure.update_xaxes(title="time [s]", row=1, col=1)
    figure.update_yaxes(title="delay [ms]", rangemode="tozero", row=1, col=1)
    figure.update_xaxes(title="delay [ms]", rangemode="tozero", row=1, col=2)
    figure.update_yaxes(
        title="commands later [%]", type="log", tickvals=[100, 10, 1, 0.1, 0.01, 0.001],
        ticktext=["100", "10", "1", "0.1", "0.01", "0.001"], row=1, col=2,
    )  # fmt: skip
    figure.update_layout(showlegend=False)
    return figure


def _input(
    figure: go.Figure, row: int, loop: LoopRecord, limit: float, inside: NDArray[np.bool_] | None = None
) -> None:
    chosen = np.ones(len(loop.time), dtype=bool) if inside is None else inside
    line(figure, row, loop.time[chosen], loop.input[chosen], "input", INPUT, shape="hv", legend=False)
    for bound in (-limit, limit):
        figure.add_hline(y=bound, line={"color": BOUND, "width": 1, "dash": "dot"}, row=row, col=1)
    unit = loop.rig.system.inputs[0].unit
    figure.update_yaxes(title=f"input [{unit}]", range=[-1.12 * limit, 1.12 * limit], row=row, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)
