"""How well a simulation meets a measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.identification.experiment import Experiment
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Scores:
    """r2 = 1 - sum e^2 / sum (y - mean y)^2; rmse in the output's unit; fit = 100 (1 - |e| / |y - mean y|) percent."""

    r2: float
    rmse: float
    fit_percent: float


def score(measured: Array, simulated: Array) -> Scores:
    """Scores of one output, both (samples,). A simulation that diverged scores minus infinity.

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


def free_run(system: System, experiment: Experiment) -> Array:
    """Strict free run: simulated outputs (samples, outputs) from one measured initial state, never re-initialised."""
    sampling = experiment.sampling
    starts = np.array([[0, 0, experiment.samples, 0]])
    first, every = experiment.states[:1].copy(), sampling.every
    _, outputs = rollouts(system, starts, first, experiment.inputs, step=sampling.step, every=every)
    return outputs
