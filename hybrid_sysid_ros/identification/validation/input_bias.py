"""The effect of a constant input bias on a free run: it is estimated at a record's beginning and held over the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import qmc

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Recurrence, System, rollouts
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.part import scored_every
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run_states
from hybrid_sysid_ros.identification.validation.unstable import check_free_run
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SPREAD = 0.01
"""Prior deviation of a bias, relative to its actuator's span."""

CORRELATION_SECONDS = 1.0
"""Free-run errors are slow: so many seconds of them count as one observation."""

POINTS, ROUNDS = 64, 5
"""Biases in a sample, and number of rounds in which the sample concentrates on the likely ones."""

WIDER = 2.0
"""Deviation of the next sample, relative to that of the likely biases, since it must reach beyond them."""

NARROWEST = 1e-3
"""Least deviation of a sample, relative to the prior's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Adapted:
    """Scores of free runs over the rest of a record, from one state, without and with a bias."""

    seconds: float
    """Length of the beginning from which the bias was estimated [s]."""
    bias: Array
    """The estimated bias, (inputs,)."""
    without: Scores
    adapted: Scores

    def content(self, system: System) -> dict[str, Any]:
        """The result as plain data: seconds, bias by input, and the scores ``without`` and ``adapted``."""
        named = dict(zip((item.name for item in system.inputs), self.bias.tolist(), strict=True))
        scores = {"without": self.without.content, "adapted": self.adapted.content}
        return {"seconds": self.seconds, "bias": named, **scores}


def adapt(system: System, record: Record, *, sampling: Sampling, spans: Array, seconds: float) -> Adapted:
    """Estimate the bias of each input over the first seconds of a record, and score the free run over the rest of it.

    Both free runs begin at the end of the first seconds, in the measured state, or in that of the simulation so far for
    states that the record does not show. Nothing after that moment is used, and both are scored on the same samples.

    spans: highest less lowest value of each input, (inputs,). Raises UserError for a record without ten samples before
    that moment and ten after it, and for an output that is constant after it; UnstableError where a free run is
    meaningless.
    """
    every = scored_every(record, sampling)
    cut = round(seconds / sampling.period) if np.isfinite(seconds) else 0
    samples = (record.samples - 1) // every + 1
    if min(cut, samples - cut) < 10:
        raise UserError(
            f"{record.name}: {record.duration:.2f} s can't be parted at {seconds:g} s: each part needs at least "
            f"{10 * sampling.period:g} s; adapt on another time"
        )
    check_free_run(system, prepare(record, system, sampling))
    seen = _first(record, cut * every + 1)
    bias = estimate(system, seen, sampling=sampling, spans=spans)
    none = np.zeros(len(bias))
    without, adapted = (_rest(system, record, seen, cut, value, sampling) for value in (none, bias))
    return Adapted(seconds=seconds, bias=bias, without=without, adapted=adapted)


def estimate(system: System, record: Record, *, sampling: Sampling, spans: Array) -> Array:
    """Posterior mean of a constant bias of each input, (inputs,), given a record, like the offset of an estimator.

        p(bias | y) ~ prod over inputs N(bias; 0, SPREAD span) * prod over outputs (sum e^2)^(-n / 2)

    e: errors of the free run under input + bias, whose deviation is unknown (Jeffreys' prior); n: their number, one in
    CORRELATION_SECONDS. Where friction holds the rig, a whole range of biases is equally likely, and the mean lies in
    its middle. The method is importance sampling (population Monte Carlo, Cappe et al. 2004), since derivatives are
    useless under dry friction.
    """
    prior = SPREAD * np.asarray(spans, dtype=float)
    sampler = qmc.MultivariateNormalQMC(np.zeros(len(prior)), seed=0)
    count = max(record.duration / CORRELATION_SECONDS, 1.0)
    centre, spread = np.zeros(len(prior)), prior.copy()
    for _ in range(ROUNDS):
        drawn = np.asarray(sampler.random(POINTS))
        points = centre + spread * drawn
        errors = np.array([_squares(system, record, point, sampling) for point in points])
        likelihood = -0.5 * count * np.log(np.maximum(errors, 1e-30)).sum(axis=1)
        log = likelihood - 0.5 * np.sum((points / prior) ** 2, axis=1) + 0.5 * np.sum(drawn**2, axis=1)
        if not np.isfinite(log).any():
            return np.zeros(len(prior))  # every simulation diverges, as the scores will show
        weights = np.exp(log - log[np.isfinite(log)].max())
        weights = np.where(np.isfinite(weights), weights, 0.0) / np.nansum(weights)
        centre = weights @ points
        spread = np.clip(WIDER * np.sqrt(weights @ (points - centre) ** 2), NARROWEST * prior, prior)
    return centre


def _squares(system: System, record: Record, bias: Array, sampling: Sampling) -> Array:
    """Sum of squared errors of each output over a record, (outputs,)."""
    experiment = prepare(_biased(record, bias), system, sampling)
    _, outputs = free_run_states(system, experiment)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.sum((outputs - experiment.outputs) ** 2, axis=0), nan=np.inf))


def _rest(system: System, record: Record, seen: Record, cut: int, bias: Array, sampling: Sampling) -> Scores:
    """Scores of the free run under a bias from sample ``cut`` on."""
    past, whole = (prepare(_biased(item, bias), system, sampling) for item in (seen, record))
    first = past.states[-1].copy()
    if not isinstance(system, Recurrence):
        known = system.record_map().reconstructible
        unshown = [i for i in range(len(system.states)) if i not in known]
        first[unshown] = free_run_states(system, past)[0][-1, unshown]
    starts = np.array([[0, cut * sampling.every, whole.samples - cut, 0]])
    _, outputs = rollouts(system, starts, first[None], whole.inputs, step=sampling.step, every=sampling.every)
    try:
        return Scores.of([item.name for item in system.outputs], whole.outputs[cut:], outputs)
    except UserError as error:
        raise UserError(f"{record.name}: {error}; leave the record out") from None


def _biased(record: Record, bias: Array) -> Record:
    return replace(record, input=record.input + bias)


def _first(record: Record, samples: int) -> Record:
    """The first samples of a record."""
    used = slice(0, samples)
    return replace(record, time=record.time[used], input=record.input[used], output=record.output[used], channels={})
