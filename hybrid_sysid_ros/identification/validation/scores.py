"""Scores of a simulation against a measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Scores of one output, or means over several."""

    r2: float
    """1 - sum e^2 / sum (y - mean y)^2."""
    rmse: float
    """Root mean square error in the output's unit; NaN for several outputs, which have several units."""
    fit_percent: float
    """100 (1 - |e| / |y - mean y|)."""
    outputs: Mapping[str, Scores] = field(default_factory=dict)
    """Scores of each of several outputs by name; empty where there is one."""

    def __str__(self) -> str:
        if self.outputs:
            return "\n".join(f"{name}: {item}" for name, item in self.outputs.items())
        return f"R2 {self.r2:.4f}, RMSE {self.rmse:.4g} (SI), fit {self.fit_percent:.1f} %"

    @property
    def content(self) -> dict[str, Any]:
        """Plain data: r2, rmse and fit_percent; for several outputs r2 and fit_percent, and ``outputs`` by name."""
        if not self.outputs:
            return {"r2": self.r2, "rmse": self.rmse, "fit_percent": self.fit_percent}
        each = {name: item.content for name, item in self.outputs.items()}
        return {"r2": self.r2, "fit_percent": self.fit_percent, "outputs": each}

    @classmethod
    def of(cls, names: Sequence[str], measured: Array, simulated: Array) -> Scores:
        """Scores of outputs (samples, outputs) by their names. Raises UserError for a constant one."""
        found = {name: score(measured[:, k], simulated[:, k]) for k, name in enumerate(names)}
        if len(found) == 1:
            return next(iter(found.values()))
        return cls(
            r2=float(np.mean([item.r2 for item in found.values()])),
            rmse=float("nan"),
            fit_percent=float(np.mean([item.fit_percent for item in found.values()])),
            outputs=found,
        )


def score(measured: Array, simulated: Array) -> Scores:
    """Scores of one output, measured and simulated (samples,). A simulation that diverged scores minus infinity.

    Raises UserError for a constant measurement, against which nothing can be scored.
    """
    if np.ptp(measured) == 0.0:
        raise UserError("the measured output is constant, so there is nothing to score")
    error = measured - simulated
    with np.errstate(over="ignore", invalid="ignore"):
        squares = float(np.sum(error**2))
    total = float(np.sum((measured - measured.mean()) ** 2))
    if not np.isfinite(squares):
        return Scores(r2=-np.inf, rmse=np.inf, fit_percent=-np.inf)
    ratio = squares / total
    return Scores(r2=1 - ratio, rmse=float(np.sqrt(squares / len(error))), fit_percent=100 * (1 - ratio**0.5))


def score_free_run(system: System, experiment: PreparedRecord) -> Scores:
    """Scores of the strict free run on measured raw outputs after the warm-up. Raises UserError for a constant output,
    naming the record.
    """
    return scores_of_run(system, experiment, free_run(system, experiment))


def scores_of_run(system: System, experiment: PreparedRecord, simulated: Array) -> Scores:
    """Scores of a run's outputs (samples, outputs), as :func:`score_free_run` has them."""
    names, scored = [item.name for item in system.outputs], experiment.scored
    try:
        return Scores.of(names, experiment.outputs[scored], simulated[scored])
    except UserError as error:
        raise UserError(f"{experiment.name}: {error}; leave the record out") from None


def free_run(system: System, experiment: PreparedRecord) -> Array:
    """Strict free run: simulated outputs (samples, outputs) from one initial state, never re-initialised."""
    return free_run_states(system, experiment)[1]


def free_run_states(system: System, experiment: PreparedRecord) -> tuple[Array, Array]:
    """States (samples, states) and outputs (samples, outputs) of the strict free run."""
    sampling = experiment.sampling
    starts = np.array([[0, 0, experiment.samples, 0]])
    first = initial_state(system, experiment)[None]
    return rollouts(system, starts, first, experiment.inputs, step=sampling.step, every=sampling.every)
