"""Gain of a model over another one on the same records: whose free runs are nearer, and how certain that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.bands import correlation_time
from hybrid_sysid_ros.identification.validation.scores import free_run
from hybrid_sysid_ros.identification.validation.unstable import check_free_run
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LEVEL = 0.95
"""Certainty with which a model must be better, a convention."""
FEWEST = 5.0
"""Independent errors below which nothing is certain, a convention: Student's quantile at LEVEL is then 2.13, 30 % above
the normal one.
"""
MOST = 1e6
"""Largest error that counts, that of a run which diverges."""


@dataclass(frozen=True, kw_only=True)
class ModelGain:
    """Squared errors of a model less those of another one, in each output's variance, means over the outputs."""

    gain: float
    """Mean by which those of the other model are larger: the difference of R2."""
    error: float
    """Its standard error."""
    independent: float
    """Number of independent errors that it is made of."""

    @classmethod
    def of(cls, gains: Sequence[Array]) -> ModelGain:
        """Of the differences in each record, (scored samples,)."""
        joined = np.concatenate(gains)
        independent = len(joined) / correlation_time(gains)
        error = float(np.std(joined)) / float(np.sqrt(max(independent - 1.0, 1.0)))
        return cls(gain=float(joined.mean()), error=error, independent=independent)

    @property
    def needed(self) -> float:
        """Gain that is certain at LEVEL, by Student's distribution."""
        return float(t.ppf(LEVEL, max(self.independent - 1.0, 1.0))) * self.error

    @property
    def is_better(self) -> bool:
        """Whether the model beats the other one by more than the uncertainty."""
        return self.independent >= FEWEST and self.gain > self.needed


def gain_of(model: Model, other: Model, records: Sequence[Record], part: Part) -> ModelGain:
    """Compare free runs over (a part of) records, sample by sample.

    Errors of a free run are slow, so as many samples as a correlation time count as one: Diebold & Mariano (1995), J.
    Bus. Econ. Stat. 13(3). Raises UserError for models of other rigs or periods, a record that one of them was trained
    on, and UnstableError where a free run is meaningless.
    """
    if model.rig != other.rig:
        raise UserError(f"one model is of rig {model.rig}, the one in use of {other.rig}; give two of the same rig")
    if model.sampling.period != other.sampling.period:
        periods = f"{model.sampling.period:g} and {other.sampling.period:g} s"
        raise UserError(f"the models are scored every {periods}; fit one again with the period of the other (--period)")
    for record in records:
        for which, one in (("the model", model), ("the one in use", other)):
            if one.was_trained_on(record.digest, part.start, part.stop):
                raise UserError(f"{record.name}: {which} was trained on it; give records that neither has seen")
    return ModelGain.of([_errors(other, record, part) - _errors(model, record, part) for record in records])


def _errors(model: Model, record: Record, part: Part) -> Array:
    """Squared errors of a free run in the outputs' variances, means over the outputs, (scored samples,)."""
    experiment = experiment_of(model, record, part=part)
    check_free_run(model.system, experiment)
    scored, measured = experiment.scored, experiment.outputs
    variances = np.var(measured[scored], axis=0)
    if not np.all(variances > 0.0):
        raise UserError(f"{record.name}: an output is constant, so nothing can be compared; leave the record out")
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.mean((free_run(model.system, experiment) - measured) ** 2 / variances, axis=1)[scored]
    return np.asarray(np.minimum(np.nan_to_num(squares, nan=np.inf), MOST))
