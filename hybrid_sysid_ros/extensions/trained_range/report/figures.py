"""The section of a report on what its model was trained on: a map, and the runs on it."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from hybrid_sysid_ros.extensions.shared.report.charts import LINES, REFERENCE, dress
from hybrid_sysid_ros.extensions.shared.report.sections import FreeRunSection, IdentificationSection
from hybrid_sysid_ros.extensions.trained_range.motion import PER_OUTPUT
from hybrid_sysid_ros.extensions.trained_range.trained_range import TrainedRange
from hybrid_sysid_ros.report import FurtherSection
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection
from hybrid_sysid_ros.support.arrays import Array

MOST = 400
"""Points of a run that are drawn."""


def section(identification: IdentificationSection, closed_loop: ClosedLoopSection | None) -> FurtherSection | None:
    """Typical motions of the training records and those of the runs, for each output; None for a model without."""
    content = identification.model.note("trained_range")
    if not content:
        return None
    system = identification.model.system
    trained = TrainedRange.from_content(content, system)
    seconds = trained.scales.samples[-1] * identification.model.sampling.period
    figures = [
        _map(trained, identification, k, seconds)
        for k in range(len(system.outputs))
        if any(run.output.name == system.outputs[k].name for run in identification.runs)
    ]
    return FurtherSection(
        title="Trained range",
        text=f"Grey: what typical motions of the training records do within {seconds:.3g} s, by speed and range. "
        "Coloured: the model's own runs. A run away from the grey points does what the model was not trained on. Rest "
        "and slow motion are below, falling motion is at the left.",
        figures=figures,
    )


def _map(trained: TrainedRange, identification: IdentificationSection, output: int, seconds: float) -> go.Figure:
    """Range over mean speed of an output."""
    item, scales = identification.model.system.outputs[output], trained.scales
    figure = go.Figure()
    dress(figure, 380)
    moved, spans = scales.moved(trained.typical, output)
    _points(figure, moved / seconds, spans, "trained on", REFERENCE, 9, scales.none[output])
    runs = [run for run in identification.runs if run.output.name == item.name]
    for number, run in enumerate(runs):
        _run(figure, trained, run, output, seconds, LINES[number % len(LINES)])
    figure.update_xaxes(title=f"mean speed of {item.name} over {seconds:.3g} s [{item.unit}/s]")
    figure.update_yaxes(title=f"range of {item.name} over {seconds:.3g} s [{item.unit}]", type="log")
    figure.update_layout(hovermode="closest", legend={"y": 1.02}, margin={"t": 60})
    return figure


def _run(
    figure: go.Figure, trained: TrainedRange, run: FreeRunSection, output: int, seconds: float, colour: str
) -> None:
    """Draw a run."""
    values = np.interp(run.residual_time, run.simulated_time, run.simulated)
    p, scales = len(trained.scales.outputs), trained.scales
    outputs = np.zeros((len(values), p))
    outputs[:, output] = values
    if len(values) <= scales.samples[-1]:
        return
    features = scales.features(outputs, np.zeros((len(values), len(scales.inputs))))[:, : PER_OUTPUT * p]
    moved, spans = scales.moved(features[:: max(1, len(features) // MOST)], output)
    _points(figure, moved / seconds, spans, run.record, colour, 4, scales.none[output])


def _points(figure: go.Figure, x: Array, y: Array, name: str, colour: str, size: int, least: float) -> None:
    """Draw points, those at rest at the lowest range that tells."""
    figure.add_scatter(
        x=x, y=np.maximum(y, 0.1 * least), name=name, mode="markers", hovertemplate="%{x:.3g}, %{y:.3g}",
        marker={"color": colour, "size": size, "opacity": 0.6 if size > 5 else 0.8},
    )  # fmt: skip
