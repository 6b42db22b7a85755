"""Use of a model: where its own run over a record leaves what it was trained on, before the measurement is seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.trained_range.trained_range import TrainedRange, mean_inputs
from hybrid_sysid_ros.extensions.trained_range.words import reason
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.arrays import Array

NOT, PARTLY = 0.5, 0.1
"""Shares of a run outside of the trained range from which a model is not, or only partly, trained for it,
conventions of this project. PARTLY is ten times what is accused wrongly.
"""
LASTING = 20
"""Samples, of which half are outside where a run leaves the range and does not merely touch its edge."""


def checked(model: Model, experiment: PreparedRecord, run: Array) -> dict[str, Any] | None:
    """Verdict, share of the run outside, since when [s], and a sentence; None for a model without a trained range or a
    record that is too short. run: (samples, outputs), of the model alone, from its first state and the inputs.
    """
    if not (content := model.note("trained_range")):
        return None
    trained, period = TrainedRange.from_content(content, model.system), experiment.sampling.period
    inputs, past = mean_inputs(experiment), trained.scales.samples[-1]
    if len(run) <= past:
        return None
    away = trained.outside(run, inputs)
    share = float(np.mean(away[past:]))
    verdict = "not trained" if share >= NOT else "partly trained" if share >= PARTLY else "trained"
    words = f"{experiment.name}: {verdict}: {100.0 * (1.0 - share):.0f} % of the run is like what the model has seen"
    lasting, since = np.convolve(away, np.ones(LASTING), mode="valid") >= LASTING / 2, None
    if verdict != "trained" and lasting.any():
        since = float(np.argmax(away & (np.arange(len(away)) >= np.argmax(lasting)))) * period
        why = reason(trained, trained.scales.features(run, inputs)[away[past:]], model.system, period)
        words += f"; from {since:.3g} s on {why}"
    if beyond := _beyond_travel(model, run, period):
        words += f"; {beyond}"
    return {"verdict": verdict, "outside": share, "since": since, "sentence": words}


def _beyond_travel(model: Model, run: Array, period: float) -> str:
    """Where the run leaves the travel of the rig; "" where it does not."""
    low, high = rigs.load(model.rig).travel_of_outputs
    beyond = (run < low) | (run > high) | ~np.isfinite(run)
    if not beyond.any():
        return ""
    first = int(np.argmax(beyond.any(axis=1)))
    name = model.system.outputs[int(np.argmax(beyond[first]))].name
    return f"at {first * period:.1f} s {name} leaves the rig's travel"
