"""Validation of models of unstable rigs, whose open free run is meaningless: predictions from estimated states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.core.wrappers import feedback_of
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.shooting import (
    UnstableFitSettings,
    fastest_growth,
    held_inputs,
    parts_from,
    runs_away,
    settled,
)
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

PAST, APART = 2.0, 0.5
"""Seconds of a record from which the initial state of a prediction is estimated, and seconds between predictions."""
SECOND = 20
"""Samples that count as a second for a rig without a stabiliser, whose period may be microseconds or hours."""
REMEDY = "judge it by predictions of some seconds, and in closed loop"
AHEAD = ((1.0, False), (5.0, False), (20.0, True))
"""Horizons [s] of predictions, and whether the stabiliser closes them."""


class UnstableError(UserError):
    """A free run is meaningless, since the system is unstable."""


class UnsureRunError(UnstableError):
    """A free run could go either way, by what is not known of its start."""


def check_free_run(system: System, experiment: PreparedRecord) -> None:
    """Raise UnstableError for a system whose free run over an experiment is meaningless, and has left the record: it is
    linearly unstable at rest, so that an initial error grows a million times, or runs part on the way.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.mean((free_run(system, experiment) - experiment.outputs) ** 2, axis=0)
    if np.all(squares < np.var(experiment.outputs, axis=0)):
        return  # a nonlinear term bounds the growth, and the run follows the record
    if runs_away(system, experiment):
        seconds = experiment.sampling.period * (experiment.samples - 1)
        why = (
            f"an open free run over {seconds:.0f} s is meaningless for an unstable system: an error grows by e in "
            f"{1.0 / fastest_growth(system):.3g} s"
        )
    elif np.ptp(experiment.outputs, axis=0).all() and (parting := parts_from(system, experiment)) is not None:
        # an output that never moves has no score, which is the thing to say of it
        why = f"no free run is sure: from {parting:.3g} s on, what is not known of the start leads either way"
        raise UnsureRunError(f"{experiment.name}: {why}; {REMEDY}")
    else:
        return
    raise UnstableError(f"{experiment.name}: {why}; {REMEDY}")


def has_free_run(system: System, experiment: PreparedRecord) -> bool:
    """Whether the free run over an experiment says something, see :func:`check_free_run`."""
    try:
        check_free_run(system, experiment)
    except UnstableError:
        return False
    return True


@dataclass(frozen=True, kw_only=True)
class PredictionErrors:
    """Errors of predictions over a horizon."""

    seconds: float
    closed: bool
    """Whether the stabiliser held the simulation."""
    count: int
    """Number of predictions."""
    scores: Scores
    """Scores of the outputs at the horizon; R2 uses the variance of the record's output."""

    @property
    def content(self) -> dict[str, Any]:
        """Plain data."""
        return {"seconds": self.seconds, "closed": self.closed, "beginnings": self.count, **self.scores.content}


def predictions(
    system: System,
    experiment: PreparedRecord,
    windows: UnstableFitSettings | None,
) -> list[PredictionErrors]:
    """Errors of predictions over horizons, in open loop or with the stabiliser, where the record is long enough.

    Each begins in the state that fits the preceding PAST seconds best (states that no output shows come from the run
    with the stabiliser), and uses only the inputs after that; in closed loop these contain the stabiliser's answer to
    measurement noise. A prediction begins every APART seconds. Where an error grows by e in less than a second, that
    time stands for a second. Without windows the rig has no stabiliser: 20 samples are a second then, unless an error
    grows by e in fewer, and the preceding samples decide all states.

    Raises UserError for a stabiliser that does not fit the record's sampling.
    """
    sampling, n = experiment.sampling, len(system.declared_states)
    slowest = 1.0 if windows is not None else 1.0 / (sampling.period * SECOND)
    second = 1.0 / max(fastest_growth(system), slowest)
    past, stride = round(PAST * second / sampling.period), max(round(APART * second / sampling.period), 1)
    far = windows is not None or not runs_away(system, experiment)  # what no stabiliser closes runs away
    ahead = [(seconds * second, closed and windows is not None) for seconds, closed in AHEAD if far or not closed]
    hidden = [*system.record_map().unobserved, *range(n, len(system.states))]
    free, initial = [k for k in range(n) if k not in hidden], experiment.states.copy()
    if windows is None or windows.stabiliser is None:
        free, initial[:, hidden] = [*free, *hidden], initial_state(system, experiment)[hidden]
        noise = np.maximum(
            1e-3 * np.std(experiment.outputs, axis=0), 0.0 if experiment.noise is None else experiment.noise
        )
    else:
        initial[:, hidden] = np.nan_to_num(stabilised_run(system, experiment, windows.stabiliser)[0][:, hidden])
        noise = np.where(windows.noise > 0.0, windows.noise, 1e-3 * np.std(experiment.outputs, axis=0))
    given: dict[str, Any] = {"step": sampling.step, "every": sampling.every}
    found = []
    for seconds, closed in ahead:
        length = round(seconds / sampling.period)
        begins = np.arange(0, experiment.samples - past - length, stride)
        if not len(begins):
            continue
        starts = np.array([[0, b * sampling.every, past + 1, k * (past + 1)] for k, b in enumerate(begins)])
        seen = np.concatenate([experiment.outputs[b : b + past + 1] for b in begins])
        first = settled(
            system, starts, np.ascontiguousarray(initial[begins]), experiment.inputs, seen,
            free=free, noise=noise, **given,
        )  # fmt: skip
        states, _ = rollouts(system, starts, first, experiment.inputs, **given)
        from_here = np.ascontiguousarray(states[starts[:, 3] + past])
        then = np.array([[0, (b + past) * sampling.every, length + 1, k * (length + 1)] for k, b in enumerate(begins)])
        inputs, options = experiment.inputs, dict(given)
        if closed and windows is not None and windows.stabiliser is not None:
            inputs = held_inputs(system, experiment, windows.stabiliser)
            options["feedback"] = feedback_of(system, windows.stabiliser)
        _, outputs = rollouts(system, then, from_here, inputs, **options)
        simulated, measured = outputs[then[:, 3] + length], experiment.outputs[begins + past + length]
        found.append(
            PredictionErrors(
                seconds=seconds,
                closed=closed,
                count=len(begins),
                scores=_scores(system, experiment, measured, simulated),
            )
        )
    return found


def _scores(system: System, experiment: PreparedRecord, measured: Array, simulated: Array) -> Scores:
    """Scores by the deviations of the whole record."""
    deviation = np.std(experiment.outputs, axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        rmse = np.nan_to_num(np.sqrt(np.mean((simulated - measured) ** 2, axis=0)), nan=np.inf)
        ratio = rmse / deviation
        each = {
            item.name: Scores(r2=float(1.0 - share**2), rmse=float(error), fit_percent=float(100.0 * (1.0 - share)))
            for item, error, share in zip(system.outputs, rmse, ratio, strict=True)
        }
    if len(each) == 1:
        return next(iter(each.values()))
    r2, fit = (float(np.mean([getattr(item, key) for item in each.values()])) for key in ("r2", "fit_percent"))
    return Scores(r2=r2, rmse=float("nan"), fit_percent=fit, outputs=each)


def stabilised_run(system: System, experiment: PreparedRecord, stabiliser: Array) -> tuple[Array, Array]:
    """States (samples, states) and outputs (samples, outputs) of one run over the whole record, in closed loop with the
    stabiliser.
    """
    sampling = experiment.sampling
    starts = np.array([[0, 0, experiment.samples, 0]])
    first = initial_state(system, experiment)[None]
    inputs, feedback = held_inputs(system, experiment, stabiliser), feedback_of(system, stabiliser)
    return rollouts(system, starts, first, inputs, step=sampling.step, every=sampling.every, feedback=feedback)
