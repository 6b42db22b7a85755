"""A peer: another way to a model of the same records, chosen and timed like any other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hybrid_sysid_ros.identification import PreparedRecord, score
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array

Simulation = Callable[[PreparedRecord], Array]
"""Strict free run: outputs (samples,) [rad] of an experiment, from its first samples and its inputs alone."""

SCORED_SECONDS = 0.05
DIVERGED = -1.0
"""A free run that scores less counts as this much where candidates are compared, so that one doesn't decide alone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """seconds: of the fit without compilation, which took compile_seconds.

    snapshots: (seconds, simulation) as the fit went on; the last one is its result.
    """

    seconds: float
    compile_seconds: float = 0.0
    snapshots: Sequence[tuple[float, Simulation]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Peer:
    """fit(experiments, **candidate): a fit with one of the candidate settings, which are compared on training records.

    sampling: at which the peer gets its experiments. folds: of the cross-validation that chooses; at most one a record.
    packages: whose versions matter.
    """

    name: str
    packages: Sequence[str]
    sampling: Sampling
    fit: Callable[..., Fitted]
    candidates: Sequence[Mapping[str, Any]] = field(default_factory=lambda: ({},))
    folds: int = 2

    def choose(self, experiments: Sequence[PreparedRecord]) -> tuple[Mapping[str, Any], float]:
        """The candidate of the best mean free-run R2 on whole records that were left out, and the seconds it took."""
        if len(self.candidates) == 1:
            return self.candidates[0], 0.0
        began = time.perf_counter()
        folds = min(self.folds, len(experiments))

        def validated(candidate: Mapping[str, Any]) -> float:
            found = []
            for fold in range(folds):
                kept = [item for index, item in enumerate(experiments) if index % folds != fold]
                simulation = self.fit(kept, **candidate).snapshots[-1][1]
                found += [max(r2(simulation, item), DIVERGED) for item in experiments[fold::folds]]
            return float(np.mean(found))

        best = max(self.candidates, key=validated)
        return best, time.perf_counter() - began


def r2(simulation: Simulation, experiment: PreparedRecord) -> float:
    """Free-run R2 on the raw output every 50 ms; minus infinity where the simulation diverges."""
    every = round(SCORED_SECONDS / experiment.sampling.period)
    with np.errstate(all="ignore"):
        simulated = simulation(experiment)
    return score(experiment.outputs[::every, 0], simulated[::every]).r2
