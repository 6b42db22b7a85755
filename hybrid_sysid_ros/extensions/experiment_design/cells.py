"""Cells of motion: where records have been, so that an experiment goes elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.extensions.experiment_design.information import run_of
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

BINS = 8
"""Of each variable."""
WIDER = 0.5
"""Share of its trained range by which a state without travel may go beyond it on each side."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Pairs of states and inputs, each in BINS between its ends, and which pairs of bins records have visited."""

    low: Array
    """(variables,)."""
    high: Array
    sampling: Sampling
    visited: frozenset[int] = field(default_factory=frozenset)

    @classmethod
    def of(cls, model: Model, rig: Rig, experiments: Sequence[PreparedRecord]) -> Cells:
        """Those that experiments have visited; a state ends at its travel, or beyond its values in them."""
        count = len(model.system.declared_states)
        states = np.concatenate([item.states[:, :count] for item in experiments])
        most, least = states.max(axis=0), states.min(axis=0)
        ends = np.stack([least - WIDER * (most - least), most + WIDER * (most - least)])
        travel = dict(zip((item.name for item in rig.system.states), rig.travel.T, strict=True))
        for k, item in enumerate(model.system.declared_states):
            own = travel.get(item.name, np.full(2, np.inf))
            ends[:, k] = np.where(np.isfinite(own), own, ends[:, k])
        low, high = np.concatenate([ends, np.stack(rig.limits)], axis=1)
        empty = cls(low=low, high=high, sampling=model.sampling)
        found = [empty.of_run(item.states, _at_samples(item.inputs, item.sampling)) for item in experiments]
        return cls(low=low, high=high, sampling=model.sampling, visited=frozenset().union(*found))

    @property
    def total(self) -> int:
        """Number of all cells."""
        count = len(self.low)
        return count * (count - 1) // 2 * BINS**2

    def of_run(self, states: Array, inputs: Array) -> frozenset[int]:
        """Cells of a run: states (samples, states), inputs (samples, inputs)."""
        count = len(self.low) - inputs.shape[1]
        values = np.concatenate([states[:, :count], inputs], axis=1)
        with np.errstate(all="ignore"):
            places = np.floor((values - self.low) / np.maximum(self.high - self.low, 1e-300) * BINS)
        inside = np.isfinite(places) & (places >= 0) & (places < BINS)
        bins, found = np.where(inside, places, 0).astype(np.int64), list[int]()
        for number, (i, j) in enumerate(combinations(range(len(self.low)), 2)):
            good = inside[:, i] & inside[:, j]
            found += np.unique((number * BINS + bins[good, i]) * BINS + bins[good, j]).tolist()
        return frozenset(found)

    def new(self, system: System, inputs: Array) -> int:
        """Number of cells that a run from rest visits and the records have not. inputs (steps, inputs)."""
        samples = len(inputs) // self.sampling.every + 1
        starts, first = run_of(system, samples)
        with np.errstate(all="ignore"):
            states, _ = rollouts(system, starts, first, inputs, step=self.sampling.step, every=self.sampling.every)
        return len(self.of_run(states, _at_samples(inputs, self.sampling)) - self.visited)


def _at_samples(inputs: Array, sampling: Sampling) -> Array:
    """Inputs at the scored samples, the last one twice."""
    taken = inputs[:: sampling.every]
    return np.concatenate([taken, inputs[-1:]])
