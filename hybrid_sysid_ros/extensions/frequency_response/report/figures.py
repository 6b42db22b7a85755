"""Figures of frequency responses."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.frequency_response.comparison import WIDTHS, ResponseComparison, gain, phase
from hybrid_sysid_ros.extensions.shared.report.charts import (
    ERROR,
    MEASURED,
    MODEL,
    REFERENCE,
    area,
    dress,
    line,
    logarithmic,
    panels,
)


def bode(found: ResponseComparison, system: System, output: int, channel: int) -> go.Figure:
    """Over frequency: gain of the record and of the model with its bands, one over the other with what 90 % of right
    models keep, phase, and the record's coherence.
    """
    figure, at = panels(heights=[0.33, 0.2, 0.31, 0.16], height=640), (slice(None), output, channel)
    frequencies, errors, limits = found.measured.frequencies, found.gain_errors[at], found.gain_limits[at]
    deviations = {1: found.gain_deviations[at], 3: np.degrees(found.phase_deviations[at])}
    for row, part in ((1, gain), (3, phase)):
        model, measured = (part(item)[at] for item in (found.simulated, found.measured))
        for level, width in sorted(WIDTHS.items(), reverse=True):
            half = width * np.nan_to_num(deviations[row], posinf=0.0)
            area(figure, row, frequencies, model - half, model + half, f"{level:.0%} band", legend=row == 1)
        turns = 360.0 * np.round((measured - model) / 360.0) if row > 1 else 0.0
        line(figure, row, frequencies, measured - turns, "measured", MEASURED, legend=row == 1)
        line(figure, row, frequencies, model, "model", MODEL, legend=row == 1)
    limits = np.where(np.isfinite(limits), limits, 0.0)
    area(figure, 2, frequencies, -limits, limits, "90 % of errors of a right model", legend=True)
    line(figure, 2, frequencies, errors, "measured over model", ERROR)
    line(figure, 4, frequencies, found.measured.coherence[:, output], "coherence", REFERENCE, legend=False)
    figure.update_xaxes(type="log", **logarithmic(float(frequencies[0]), float(frequencies[-1])))
    figure.update_xaxes(title="frequency [Hz]", row=4, col=1)
    unit = f"{system.outputs[output].unit or '1'} per {system.inputs[channel].unit or '1'}"
    titles = f"gain [dB of<br>{unit}]", "error [dB]", "phase [deg]", "coherence"
    for row, title in enumerate(titles, 1):
        figure.update_yaxes(title=title, row=row, col=1, secondary_y=False)
    figure.update_yaxes(range=[0.0, 1.02], row=4, col=1, secondary_y=False)
    figure.update_yaxes(visible=False, secondary_y=True)
    dress(figure, 640)
    return figure
