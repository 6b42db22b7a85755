"""Figures of a checked record."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from scipy.signal import coherence, welch

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.response import expected_outputs
from hybrid_sysid_ros.extensions.shared.report.charts import (
    INPUT,
    LINES,
    MEASURED,
    MODEL,
    POINTS,
    dress,
    line,
    panels,
    timed,
    titled,
)
from hybrid_sysid_ros.rigs.rig import Rig

SEGMENTS = 8
"""Of a record, from which spectra are averaged."""


def signals_over_time(record: Record, rig: Rig) -> go.Figure:
    """Inputs, and outputs beside what the rig's physics make of these inputs, in the units of the system."""
    items = [*rig.system.inputs, *rig.system.outputs]
    figure = panels(heights=[1.0 / len(items)] * len(items), height=170 * len(items))
    every = max(1, record.samples // POINTS)
    expected = expected_outputs(record, rig)
    for row, item in enumerate(items, 1):
        k = row - 1 - len(rig.system.inputs)
        values = record.input[:, row - 1] if k < 0 else record.output[:, k]
        if k >= 0 and expected is not None:
            line(figure, row, record.time[::every], expected[::every, k], "rig's physics", MODEL, legend=k == 0)
        name, colour, shape = ("input", INPUT, "hv") if k < 0 else ("measured", MEASURED, "linear")
        line(figure, row, record.time[::every], values[::every], name, colour, legend=k in (0, -1), shape=shape)
        figure.update_yaxes(title=titled(item.name, item.unit), row=row, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    return timed(figure, len(items))


def spectra(record: Record, rig: Rig) -> go.Figure:
    """Amplitude density of every signal, and the coherence of each output with each input, over frequency."""
    figure = panels(heights=[0.6, 0.4], height=360)
    length, rate = max(record.samples // SEGMENTS, 16), 1.0 / record.sampling_time
    inputs = list(zip(rig.system.inputs, record.input.T, strict=True))
    outputs = list(zip(rig.system.outputs, record.output.T, strict=True))
    for k, (item, values) in enumerate([*inputs, *outputs]):
        frequency, power = welch(values - values.mean(), rate, nperseg=length)
        level = np.sqrt(np.maximum(power, 1e-300))
        line(figure, 1, frequency[1:], level[1:] / max(level[1:].max(), 1e-300), item.name, LINES[k % len(LINES)])
    for k, (item, output) in enumerate(outputs):
        for other, values in inputs:
            if np.ptp(values) > 0.0 and np.ptp(output) > 0.0:
                frequency, shared = coherence(values, output, rate, nperseg=length)
                name = f"{item.name} with {other.name}"
                line(figure, 2, frequency[1:], shared[1:], name, LINES[(k + len(inputs)) % len(LINES)], legend=False)
    figure.update_xaxes(type="log")
    figure.update_xaxes(title="frequency [Hz]", row=2, col=1)
    figure.update_yaxes(type="log", title="amplitude", exponentformat="power", row=1, col=1, secondary_y=False)
    figure.update_yaxes(title="coherence", range=[0.0, 1.02], row=2, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    dress(figure, 360)
    return figure
