"""k-step-ahead errors: how a simulation's error grows from one sample to a free run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run_states, score
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LONGEST = 200
"""Samples of the longest horizon by default: 10 s at the usual 50 ms."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonErrors:
    """Errors of one output over the horizon."""

    name: str
    horizons: NDArray[np.int64]
    """Samples ahead, (horizons,)."""
    seconds: Array
    """Times ahead [s], (horizons,)."""
    rmse: Array
    """Root mean square errors in the output's unit, (horizons,)."""
    r2: Array
    """1 - rmse^2 / variance of the record's output, (horizons,); the free run is scored by the same variance."""
    rollouts: int
    """Number of initial samples."""
    free_run: Scores
    """Scores of the free run over the whole record, or of a given run, which long horizons approach."""


def k_step_errors(
    system: System,
    experiment: PreparedRecord,
    horizons: Sequence[int] | None = None,
    *,
    output: int = 0,
    run: tuple[Array, Array] | None = None,
) -> HorizonErrors:
    """Errors k samples ahead: simulations from every sample, with the measured state as initial one.

    horizons: in samples, by default 1 to :data:`LONGEST` (or half of the record). All horizons share the initial
    samples, from which the longest one ends within the record. The measured state is raw, so that its noise is part of
    the error at short horizons; states that the record does not show come from the run. output: index of the output.
    run: states (samples, states) and outputs (samples, outputs) over the whole record, by default the free run.

    Ljung (1999), System Identification, 2nd ed., sections 3.2 and 16.5: k-step-ahead prediction without a noise model.

    Raises UserError for a horizon below 1 or beyond the record, and for a constant output.
    """
    chosen = default_horizons(min(LONGEST, experiment.samples // 2)) if horizons is None else horizons
    ahead = np.unique(np.asarray(chosen, dtype=np.int64))
    if not len(ahead) or ahead[0] < 1 or ahead[-1] >= experiment.samples:
        raise UserError(f"{experiment.name}: horizons must be 1 to {experiment.samples - 1} samples")
    longest, sampling = int(ahead[-1]), experiment.sampling
    begins = np.arange(experiment.samples - longest)
    starts = np.zeros((len(begins), 4), dtype=np.int64)
    starts[:, 1] = begins * sampling.every
    starts[:, 2] = longest + 1
    starts[:, 3] = np.arange(len(begins)) * (longest + 1)
    states, whole = free_run_states(system, experiment) if run is None else run
    initial, hidden = experiment.states.copy(), system.record_map().unobserved
    initial[:, hidden] = states[:, hidden]
    first, inputs = np.ascontiguousarray(initial[begins]), experiment.inputs
    _, outputs = rollouts(system, starts, first, inputs, step=sampling.step, every=sampling.every)
    simulated = outputs[:, output].reshape(len(begins), longest + 1)[:, ahead]
    measured = experiment.outputs[:, output]
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.mean((simulated - measured[begins[:, None] + ahead]) ** 2, axis=0)
    squares[~np.isfinite(squares)] = np.inf
    scores = score(measured, whole[:, output])
    return HorizonErrors(
        name=experiment.name,
        horizons=ahead,
        seconds=np.asarray(sampling.period * ahead, dtype=float),
        rmse=np.sqrt(squares),
        r2=1.0 - squares / np.var(measured),
        rollouts=len(begins),
        free_run=scores,
    )


def default_horizons(longest: int) -> NDArray[np.int64]:
    """Some 25 horizons from 1 to ``longest`` samples, denser at short ones."""
    return np.unique(np.geomspace(1, max(longest, 1), 25).round().astype(np.int64))
