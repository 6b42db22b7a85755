"""Recurrent network (GRU), trained by gradients through time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.recurrent.recurrent import Recurrent, step_within
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structure import FitContext, Option, Structure


class RecurrentStructure(Structure):
    """It holds at one step alone, that of the samples or a whole part of it."""

    summary = "a recurrent network with a memory of its own"
    seeded = True

    @property
    def options(self) -> Mapping[str, Option]:
        return {"units": Option(default=24, low=2, high=64, kind="int", description="Hidden states of the GRU.")}

    def sampling(self, asked: Sampling) -> Sampling:
        return replace(asked, step=step_within(asked.period) if asked.input != "sampled" else asked.period)

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.extensions.recurrent.training import train_network, untrained

        network = untrained(self.physics, context.sampling.step, int(context.options["units"]))
        return train_network(network, context.experiments(network), seed=context.seed, progress=context.progress)

    def assemble(self, design: Mapping[str, Any], weights: NDArray[np.float64]) -> Recurrent:
        return Recurrent.of(design, weights)
