"""Policies for a plant whose slow parameters are estimated online."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.support.arrays import Array

FARTHEST = 2.0
"""Spreads within which a parameter's deviation is believed: the correction is linear in it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """u = NN(z) + NN_S(z) (theta - theta_0) / spread: NN_S is the derivative of the exact MPC's inputs by parameters.

    names: of theta. nominal, spread (parameters,) in their units. layers: of NN_S; its outputs are
    (parameters, outputs of NN) row by row, in units of the input limit. Hose, Gräfe, Trimpe (2024), Parameter-adaptive
    approximate MPC: tuning neural-network controllers without retraining, L4DC.
    """

    names: tuple[str, ...]
    nominal: Array
    spread: Array
    layers: tuple[tuple[Array, Array], ...]

    def deviation(self, values: Mapping[str, float], before: Array) -> Array:
        """Deviation (parameters,) in spreads, within +-:data:`FARTHEST`; ``before`` for what is no number."""
        found = before.copy()
        for index, name in enumerate(self.names):
            value = values.get(name, np.nan)
            if np.isfinite(value):
                found[index] = (float(value) - float(self.nominal[index])) / float(self.spread[index])
        return np.clip(found, -FARTHEST, FARTHEST)
