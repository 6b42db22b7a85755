"""How far a loop's estimate of each output may be off now, by the estimator's own covariance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array

LEAST = 1e-9
"""Least deviation of a state or disturbance over which an output's change is taken."""


def output_deviations(system: System, estimate: StateEstimate, applied: Array) -> Array:
    """Standard deviations of the estimated outputs (p,) [their units]: sqrt diag(C P C'), where C is the change of the
    outputs with states and input disturbances, over one deviation to either side.
    """
    states = len(system.states)
    place = np.concatenate([estimate.state, np.asarray(applied) + estimate.disturbance])
    covariance = estimate.covariance[: len(place), : len(place)]
    sizes = np.maximum(np.sqrt(np.diag(covariance)), LEAST)

    def outputs(at: Array) -> Array:
        return output_of(system, at[:states], at[states:])

    moves = np.diag(sizes)
    changes = [
        (outputs(place + move) - outputs(place - move)) / (2.0 * size) for move, size in zip(moves, sizes, strict=True)
    ]
    change = np.array(changes).T
    return np.asarray(np.sqrt(np.diag(change @ covariance @ change.T)))


class LiveDeviations:
    """The newest estimate, whose outputs' deviations are computed when they are asked for."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._newest: tuple[StateEstimate, Array] | None = None

    def see(self, estimate: StateEstimate, applied: Array) -> None:
        """Take an estimate, and the inputs (m,) that acted."""
        self._newest = estimate, applied.copy()

    def report(self) -> tuple[str, Mapping[str, object]]:
        """No doubt, and by output its deviation for the diagnostics."""
        outputs = self._system.outputs
        if self._newest is None:
            found = np.full(len(outputs), np.nan)
        else:
            estimate, applied = self._newest
            found = output_deviations(self._system, estimate, np.nan_to_num(applied))
        return "", {f"deviation_{item}": value for item, value in zip(outputs, found.tolist(), strict=True)}


def live_deviations_of(model: Model, settings: Mapping[str, Any]) -> LiveDeviations:
    """The check for an estimator's model and parameters."""
    return LiveDeviations(model.system)
