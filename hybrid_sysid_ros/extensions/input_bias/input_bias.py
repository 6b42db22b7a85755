"""The effect of a constant input bias on a free run: it is estimated at a record's beginning, with what is not known of
it, and held over the rest where the halves of the beginning bear each other out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import qmc

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Recurrence, System, rollouts
from hybrid_sysid_ros.identification.experiment import ResampledRecord, prepare, resample
from hybrid_sysid_ros.identification.part import scored_every
from hybrid_sysid_ros.identification.problem import CORRELATION_SECONDS
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run_states
from hybrid_sysid_ros.identification.validation.unstable import check_free_run
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SPREAD, LEAST = 0.01, 0.0015
"""Prior deviation of a bias, relative to its actuator's span, of a model that does not know that of its training, and
the least one, since few training records may have been alike.
"""

KNOWN, CLEAR = 0.5, 2.0
"""Share of its prior deviation below which a bias is known, and its deviations from none above which it is one."""

LASTS = 0.5
"""Share of a bias that is held: it is expected to change by as much as it is."""

POINTS, ROUNDS = 32, 4
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
    """The bias that was held, (inputs,): zero where it is not known or not borne out."""
    estimated: Array
    """The estimated bias, (inputs,)."""
    deviation: Array
    """Its standard deviation, (inputs,)."""
    reason: str
    """Why no bias was held; "" where one was."""
    without: Scores
    adapted: Scores

    def content(self, system: System) -> dict[str, Any]:
        """The result as plain data: seconds, and by input the bias that was held, its estimate and deviation, why none
        was held, and the scores ``without`` and ``adapted``.
        """
        names = [item.name for item in system.inputs]
        named, estimated, deviation = (
            dict(zip(names, values.tolist(), strict=True)) for values in (self.bias, self.estimated, self.deviation)
        )
        scores = {"without": self.without.content, "adapted": self.adapted.content}
        further = {"estimated": estimated, "deviation": deviation, "reason": self.reason}
        return {"seconds": self.seconds, "bias": named, **further, **scores}


def adapt(
    system: System, record: Record, *, sampling: Sampling, prior: Array, seconds: float, error: Array | None = None
) -> Adapted:
    """Estimate the bias of each input over the first seconds of a record, and score the free run over the rest of it.

    Both free runs begin at the end of the first seconds, in the measured state, or in that of the simulation so far for
    states that the record does not show. Nothing after that moment is used, and both are scored on the same samples.
    LASTS of the bias is held where it is known and clearly not zero, and where that of each half of these seconds makes
    the run over the other half better.

    prior: deviation of each bias, (inputs,). error: that of each output's free run in training, (outputs,), which no
    bias explains. Raises UserError for a record without twenty samples before that moment and ten after it, and for an
    output that is constant after it; UnstableError where a free run is meaningless.
    """
    every = scored_every(record, sampling)
    cut = round(seconds / sampling.period) if np.isfinite(seconds) else 0
    samples = (record.samples - 1) // every + 1
    if cut < 20 or samples - cut < 10:
        raise UserError(
            f"{record.name}: {record.duration:.2f} s can't be parted at {seconds:g} s: the first part needs at least "
            f"{20 * sampling.period:g} s, the rest {10 * sampling.period:g} s; adapt on another time"
        )
    check_free_run(system, prepare(record, system, sampling))
    seen = record.between(0, cut * every + 1)
    given: dict[str, Any] = {"sampling": sampling, "prior": prior, "error": error}
    estimated, deviation = estimate(system, seen, **given)
    reason, used = "", (deviation < KNOWN * prior) & (np.abs(estimated) > CLEAR * deviation)
    if not np.any(deviation < KNOWN * prior):
        reason = "these seconds do not tell it"
    elif not used.any():
        reason = "it may be none"
    elif not _borne_out(system, record, cut, every, given):
        reason = "one half of these seconds does not bear out the other's"
    bias = np.where(used & (reason == ""), LASTS * estimated, 0.0)
    none = np.zeros(len(bias))
    without, adapted = (_rest(system, record, seen, cut, value, sampling) for value in (none, bias))
    return Adapted(
        seconds=seconds, bias=bias, estimated=estimated, deviation=deviation, reason=reason, without=without,
        adapted=adapted,
    )  # fmt: skip


def adapt_model(model: Model, record: Record, *, seconds: float, spans: Array) -> Adapted:
    """:func:`adapt` with what a model knows of its training: the offsets of the inputs that its bands are made of, and
    the errors of its free runs. spans: of actuators, (inputs,), which count where it does not.
    """
    system, widths = model.system, np.asarray(spans, dtype=float)
    prior = SPREAD * widths
    if bands := model.note("bands"):
        ranges = [model.training_range[item.name] for item in system.inputs]
        trained = float(bands["offset"]) * np.array([high - low for low, high in ranges])
        prior = np.maximum(trained, LEAST * widths)
    rows = [[found.get("outputs", {}).get(item.name, found)["rmse"] for item in system.outputs]
            for found in model.scores.values()]  # fmt: skip
    error = np.sqrt(np.mean(np.square(rows), axis=0)) if rows else None
    return adapt(system, record, sampling=model.sampling, prior=prior, seconds=seconds, error=error)


def _borne_out(system: System, record: Record, cut: int, every: int, given: Mapping[str, Any]) -> bool:
    """Whether the bias of each half of some samples makes the free run over the other half better."""
    half, sampling = cut // 2 * every, given["sampling"]
    halves = record.between(0, half + 1), record.between(half, cut * every + 1)
    for one, other in (halves, halves[::-1]):
        bias, _ = estimate(system, one, **given)
        sampled = resample(other, sampling)
        before, after = (_squares(system, sampled, value) for value in (np.zeros(len(bias)), bias))
        if not np.sum(after / np.maximum(before, 1e-300)) < len(before):
            return False
    return True


def estimate(
    system: System, record: Record, *, sampling: Sampling, prior: Array, error: Array | None = None
) -> tuple[Array, Array]:
    """Posterior mean and deviation of a constant bias of each input, (inputs,) each, given a record.

        p(bias | y) ~ prod over inputs N(bias; 0, prior) * prod over outputs (error^2 + mean e^2)^(-n / 2)

    e: errors of the free run under input + bias, whose deviation is unknown (Jeffreys' prior) but no smaller than
    ``error``, (outputs,), that of training; n: their number, one in CORRELATION_SECONDS. Where friction holds the rig,
    a whole range of biases is equally likely, and the mean lies in its middle. The method is importance sampling
    (population Monte Carlo, Cappe et al. 2004), since derivatives are useless under dry friction.
    """
    prior = np.asarray(prior, dtype=float)
    sampler = qmc.MultivariateNormalQMC(np.zeros(len(prior)), seed=0)
    count, samples = max(record.duration / CORRELATION_SECONDS, 1.0), 1 + record.duration / sampling.period
    floor = 0.0 if error is None else samples * np.asarray(error) ** 2
    centre, spread, sampled = np.zeros(len(prior)), prior.copy(), resample(record, sampling)
    for _ in range(ROUNDS):
        drawn = np.asarray(sampler.random(POINTS))
        points = centre + spread * drawn
        errors = floor + np.array([_squares(system, sampled, point) for point in points])
        likelihood = -0.5 * count * np.log(np.maximum(errors, 1e-30)).sum(axis=1)
        log = likelihood - 0.5 * np.sum((points / prior) ** 2, axis=1) + 0.5 * np.sum(drawn**2, axis=1)
        if not np.isfinite(log).any():
            return np.zeros(len(prior)), prior  # every simulation diverges, as the scores will show
        weights = np.exp(log - log[np.isfinite(log)].max())
        weights = np.where(np.isfinite(weights), weights, 0.0) / np.nansum(weights)
        centre = weights @ points
        deviation = np.sqrt(weights @ (points - centre) ** 2)
        spread = np.clip(WIDER * deviation, NARROWEST * prior, prior)
    return centre, deviation


def _squares(system: System, record: ResampledRecord, bias: Array) -> Array:
    """Sum of squared errors of each output over a record, (outputs,)."""
    experiment = replace(record, inputs=record.inputs + bias, means=record.means + bias).experiment(system)
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
