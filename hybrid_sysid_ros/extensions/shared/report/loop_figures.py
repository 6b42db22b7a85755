"""Figures of a recorded loop."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from hybrid_sysid_ros.extensions.shared.report import charts
from hybrid_sysid_ros.extensions.shared.report.loop_views import bounds_of
from hybrid_sysid_ros.report.loop_section import DRIVING, ClosedLoopSection, Window
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

STATES = {"slowed": "#ffe08a", "holding": "#fdc57a", "resting": "#f0937d", "stopped": "#b9c6d8", "disarmed": "#b3b3c6"}
"""Colours of the states of the loop, from light to dark."""
TAIL_POINTS = 600  # most points of a distribution


def tracking(section: ClosedLoopSection) -> go.Figure:
    """Each tracked output with reference and tracking error, other outputs with bounds, and inputs with bounds."""
    loop, rig = section.loop, section.rig
    tracked, inputs, bounds = loop.tracked, len(rig.actuators), bounds_of(section)
    weights = [0.46, 0.24] * len(tracked) + [0.3] * (len(bounds) + inputs)
    figure = charts.panels(heights=[weight / sum(weights) for weight in weights], height=round(540 * sum(weights)))
    for number, k in enumerate(tracked):
        row, output, display = 1 + 2 * number, rig.system.outputs[k], rig.display[k]
        reference, measured = display.shown(loop.reference[:, k]), display.shown(loop.outputs[:, k])
        charts.line(figure, row, loop.time, measured, "measured", charts.MEASURED, legend=number == 0)
        charts.line(figure, row, loop.time, reference, "reference", charts.REFERENCE, width=1.4, legend=number == 0)
        error = display.shown(loop.error[:, k])
        charts.line(figure, row + 1, loop.time, error, f"reference {charts.MINUS} measured", charts.ERROR, legend=False)
        charts.scaled(figure, row, [reference, measured], output.name, output, display)
        charts.scaled(figure, row + 1, [error], "error", output, display, symmetric=True)
    for row, (k, limits) in enumerate(bounds.items(), start=1 + 2 * len(tracked)):
        _bounded(figure, row, loop, k, limits)
    for j in range(inputs):
        _input(figure, 1 + 2 * len(tracked) + len(bounds) + j, loop, j)
    for name, value in section.rmse.items():
        window = section.windows[name]
        axis = 1 + 4 * tracked.index(window.output)  # of the output's panel: a row has two axes
        figure.add_annotation(
            x=(window.start + min(window.stop, loop.time[-1])) / 2, y=1.0, xref="x",
            yref=f"y{axis if axis > 1 else ''} domain", yanchor="bottom",
            text=f"{name.replace('_', ' ')}: RMSE {value:.3f} {section.units[name]}", showarrow=False,
            font={"size": 12},
        )  # fmt: skip
    spells = [spell for spell in loop.spells if spell[2] != DRIVING]
    for start, stop, state in spells:
        colour = STATES.get(state, charts.BOUND)
        figure.add_vrect(x0=start, x1=stop, fillcolor=colour, opacity=0.4, line_width=0, layer="below", row=1, col=1)
    for state in dict.fromkeys(state for *_, state in spells):
        marker = {"color": STATES.get(state, charts.BOUND), "symbol": "square", "size": 11}
        figure.add_trace(go.Scatter(x=[None], y=[None], mode="markers", marker=marker, name=state), row=1, col=1)
    figure.update_layout(margin={"t": 48}, legend={"y": 1.05})
    return charts.timed(figure, len(weights))


def zoom(section: ClosedLoopSection, window: Window) -> go.Figure:
    """An output with its reference, and the inputs, over a window."""
    loop, rig = section.loop, section.rig
    output, display = rig.system.outputs[window.output], rig.display[window.output]
    inside, inputs = loop.within(window.start, window.stop), len(rig.actuators)
    weights = [0.62] + [0.38] * inputs
    figure = charts.panels(heights=[weight / sum(weights) for weight in weights], height=round(380 * sum(weights)))
    reference = display.shown(loop.reference[inside, window.output])
    measured = display.shown(loop.outputs[inside, window.output])
    charts.line(figure, 1, loop.time[inside], measured, "measured", charts.MEASURED)
    charts.line(figure, 1, loop.time[inside], reference, "reference", charts.REFERENCE, width=1.6)
    for j in range(inputs):
        _input(figure, 2 + j, loop, j, inside)
    charts.scaled(figure, 1, [reference, measured], output.name, output, display)
    return charts.timed(figure, 1 + inputs)


def delays(section: ClosedLoopSection) -> go.Figure:
    """Delay of every command over time, and the share of commands above each delay."""
    loop = section.loop
    values = 1e3 * (loop.delay if loop.is_real_time else loop.turnaround)
    figure = make_subplots(rows=1, cols=2, column_widths=[0.6, 0.4], horizontal_spacing=0.09)
    running = loop.time >= 0.0
    time, values, late = loop.time[running], values[running], loop.late[running]
    figure.add_trace(go.Scatter(x=time, y=values, line={"color": charts.MEASURED, "width": 0.9}, name="delay"), 1, 1)
    if late.any():
        figure.add_trace(
            go.Scatter(
                **charts.data(time[late], np.nan_to_num(values[late])), mode="markers", name="missed", cliponaxis=False,
                marker={"color": charts.BOUND, "symbol": "x", "size": 8},
            ), 1, 1,
        )  # fmt: skip
    known = np.sort(values[np.isfinite(values)])
    if len(known):
        share = 100.0 * (1.0 - np.arange(len(known)) / len(known))
        chosen = np.unique(np.geomspace(1, len(known), TAIL_POINTS).astype(int))
        chosen = len(known) - chosen[::-1]
        figure.add_trace(
            go.Scatter(**charts.data(known[chosen], share[chosen]), line={"color": charts.MEASURED, "width": 1.6}), 1, 2
        )
        marks = (("p50", 50.0, np.percentile(known, 50)), ("p99", 1.0, np.percentile(known, 99)),
                 ("max", share[-1], known[-1]))  # fmt: skip
        for name, y, x in marks:
            figure.add_trace(
                go.Scatter(
                    x=[float(x)], y=[float(y)], mode="markers+text", text=[f"  {name} {x:.2f} ms"],
                    textposition="middle left" if name == "max" else "middle right", cliponaxis=False,
                    marker={"color": charts.MODEL, "size": 7}, hoverinfo="skip",
                ), 1, 2,
            )  # fmt: skip
    charts.dress(figure, 320)
    figure.update_xaxes(title="time [s]", row=1, col=1)
    figure.update_yaxes(title="delay [ms]", rangemode="tozero", row=1, col=1)
    figure.update_xaxes(title="delay [ms]", rangemode="tozero", row=1, col=2)
    figure.update_yaxes(
        title="commands later [%]", type="log", tickvals=[100, 10, 1, 0.1, 0.01, 0.001],
        ticktext=["100", "10", "1", "0.1", "0.01", "0.001"], row=1, col=2,
    )  # fmt: skip
    figure.update_layout(showlegend=False)
    return figure


def _bounded(figure: go.Figure, row: int, loop: LoopRecord, k: int, limits: tuple[float, float]) -> None:
    """Draw an output with its bounds."""
    output, display = loop.rig.system.outputs[k], loop.rig.display[k]
    measured = display.shown(loop.outputs[:, k])
    bounds = [float(display.shown(np.float64(limit))) for limit in limits if np.isfinite(limit)]
    charts.line(figure, row, loop.time, measured, "measured", charts.MEASURED, legend=False)
    for bound in bounds:
        figure.add_hline(y=bound, line={"color": charts.BOUND, "width": 1, "dash": "dot"}, row=row, col=1)
    charts.scaled(figure, row, [measured, np.array(bounds)], output.name, output, display)


def _input(figure: go.Figure, row: int, loop: LoopRecord, index: int, inside: NDArray[np.bool_] | None = None) -> None:
    """Draw an input with its bounds."""
    chosen = np.ones(len(loop.time), dtype=bool) if inside is None else inside
    actuator, item = loop.rig.actuators[index], loop.rig.system.inputs[index]
    charts.line(
        figure, row, loop.time[chosen], loop.inputs[chosen, index], item.name, charts.INPUT, shape="hv", legend=False
    )
    for bound in (actuator.low, actuator.high):
        figure.add_hline(y=bound, line={"color": charts.BOUND, "width": 1, "dash": "dot"}, row=row, col=1)
    margin = 0.06 * (actuator.high - actuator.low)
    ends = [actuator.low - margin, actuator.high + margin]
    figure.update_yaxes(title=charts.titled(item.name, item.unit), range=ends, row=row, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, row=row, col=1, secondary_y=True)
