"""Several models of one rig together: the mean of their free runs, and how far they spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run
from hybrid_sysid_ros.identification.validation.unstable import check_free_run
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DEVIATIONS = 2.0
"""Of the members about their mean: the band that is asked whether it holds the measurement."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ensemble:
    """Free runs of several models over one record."""

    names: Sequence[str]
    """Of the outputs."""
    measured: Array
    """(samples, outputs)."""
    members: Array
    """(models, samples, outputs)."""

    @property
    def mean(self) -> Array:
        """(samples, outputs)."""
        return np.asarray(self.members.mean(axis=0))

    @property
    def spread(self) -> Array:
        """Deviation of the members about their mean, (samples, outputs)."""
        return np.asarray(self.members.std(axis=0, ddof=1))

    @property
    def scores(self) -> list[Scores]:
        """Of each member, and of the mean last."""
        return [Scores.of(self.names, self.measured, run) for run in (*self.members, self.mean)]

    @property
    def covered(self) -> Array:
        """Share of the samples of each output within DEVIATIONS of the mean, (outputs,): 1 where the members differ as
        much as they err, little where they err alike.
        """
        return np.asarray(np.mean(np.abs(self.measured - self.mean) <= DEVIATIONS * self.spread, axis=0))


def ensemble(models: Sequence[Model], record: Record, *, part: Part = Part()) -> Ensemble:
    """The free runs of models over a part of a record.

    Raises UserError for fewer than two models, of several rigs or scored at several periods, and for a free run that
    diverges; UnstableError where one says nothing.
    """
    if len(models) < 2:
        raise UserError("ensemble: give two models or more")
    for what, found in (
        ("rigs", {model.rig for model in models}),
        ("periods", {f"{model.sampling.period:g} s" for model in models}),
    ):
        if len(found) > 1:
            raise UserError(
                f"ensemble: the models are of several {what}, {', '.join(sorted(found))}: give those of one"
            )
    experiments = [experiment_of(model, record, part=part) for model in models]
    for model, experiment in zip(models, experiments, strict=True):
        check_free_run(model.system, experiment)
    runs = [free_run(model.system, experiment) for model, experiment in zip(models, experiments, strict=True)]
    for model, run in zip(models, runs, strict=True):
        if not np.isfinite(run).all():
            raise UserError(f"ensemble: the free run of {model.structure} over {record.name} diverges; leave it out")
    return Ensemble(
        names=[item.name for item in models[0].system.outputs],
        measured=experiments[0].outputs,
        members=np.stack(runs),
    )
