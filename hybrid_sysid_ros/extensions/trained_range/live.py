"""Where a running loop leaves what its model was trained on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.extensions.trained_range.trained_range import TrainedRange
from hybrid_sysid_ros.extensions.trained_range.use import NOT
from hybrid_sysid_ros.extensions.trained_range.words import reason
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array


class LiveRange:
    """Compares a loop's motion with the trained ones, once a scored period of the model."""

    def __init__(self, model: Model, trained: TrainedRange, rate: float) -> None:
        """rate: of estimates [1/s]."""
        self._model, self._trained = model, trained
        self._every = max(round(model.sampling.period * rate), 1)
        kept = 2 * trained.scales.samples[-1]
        self._outputs: deque[Array] = deque(maxlen=kept)
        self._inputs: deque[Array] = deque(maxlen=kept)
        self._sum, self._count = np.zeros(len(model.system.inputs)), 0

    def see(self, estimate: StateEstimate, applied: Array) -> None:
        """Take an estimate, and the inputs (m,) that acted."""
        self._sum += np.nan_to_num(applied)
        self._count += 1
        if self._count == self._every:
            inputs = self._sum / self._count
            self._outputs.append(output_of(self._model.system, estimate.state, inputs + estimate.disturbance))
            self._inputs.append(inputs)
            self._sum, self._count = np.zeros_like(inputs), 0

    def report(self) -> tuple[str, Mapping[str, object]]:
        """What is untrained of the last time of the longest displacement, "" for nothing or too little past, and values
        for the diagnostics.
        """
        past = self._trained.scales.samples[-1]
        if len(self._outputs) < 2 * past:
            return "", {"untrained_share": float("nan")}
        outputs, inputs = np.array(self._outputs), np.array(self._inputs)
        away = self._trained.outside(outputs, inputs)[past:]
        share = float(np.mean(away))
        words = ""
        if share >= NOT:
            features = self._trained.scales.features(outputs, inputs)[away]
            words = reason(self._trained, features, self._model.system, self._model.sampling.period)
        return words, {"untrained_share": share}


def live_range_of(model: Model, settings: Mapping[str, Any]) -> LiveRange | None:
    """The check for an estimator's model and parameters; None for a model without a trained range."""
    content = model.note("trained_range")
    return LiveRange(model, TrainedRange.from_content(content, model.system), settings["rate"]) if content else None
