"""Policies for a plant whose slow parameters are estimated online."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

FARTHEST = 2.0
"""Spreads within which a parameter's deviation is believed: the correction is linear in it."""


@dataclass(frozen=True, kw_only=True)
class Adaptation:
    """Parameters that are followed, and how far from the model's they are expected [their unit]; both (parameters,).

    Raises UserError for a spread that is no number above 0.
    """

    names: tuple[str, ...] = ()
    spread: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.names) != len(self.spread):
            raise UserError(
                f"policy: {len(self.names)} followed parameters have {len(self.spread)} spreads; give each one"
            )
        for name, spread in zip(self.names, self.spread, strict=True):
            if not 0.0 < spread < np.inf:
                raise UserError(f"policy: {name} can't be followed by {spread:g}: give a spread above 0, in its unit")

    def nominal(self, system: System) -> Array:
        """The equation's own values (parameters,). Raises UserError where it has no such parameter."""
        known = {item.name: float(value) for item, value in zip(system.parameters, system.values, strict=True)}
        for name in self.names:
            if name not in known:
                raise UserError(f"policy: {type(system).__name__} has no parameter {name} to follow")
        return np.array([known[name] for name in self.names])

    def shifted(self, system: System, index: int, spreads: float) -> System:
        """The equation with one of the parameters moved by so many of its spreads."""
        names = [item.name for item in system.parameters]
        values = system.values.copy()
        values[names.index(self.names[index])] += spreads * self.spread[index]
        return system.with_values(values)


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
