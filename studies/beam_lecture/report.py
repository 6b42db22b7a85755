"""A protocol: many structures, identified on the same parts of the same records and judged on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.shared.horizons import HorizonErrors
from hybrid_sysid_ros.extensions.shared.report.sections import IdentificationSection, identification_section
from hybrid_sysid_ros.identification import Part, Scores, free_run
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.sensor import Display
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.criteria import ModelCriteria, judge


@dataclass(frozen=True, kw_only=True, eq=False)
class StructureResult:
    """How one structure did.

    r2: free-run R2 by record, one mapping for each seed. published: somebody else's, by record, as far as known.
    seconds: time of one fit. chosen: this is the protocol's pick; by its cross_validation score, R2, not by the r2 of
    the test records. model, runs: what to show in full, a model of one seed and the (parts of) records to run it over.
    """

    name: str
    r2: Sequence[Mapping[str, float]]
    seconds: float
    published: Mapping[str, float] | None = None
    chosen: bool = False
    cross_validation: float | None = None
    model: Model | None = None
    runs: Sequence[tuple[Record, Part]] = ()

    @property
    def mean(self) -> dict[str, float]:
        """R2 by record, mean over seeds."""
        return {name: float(np.mean([seed[name] for seed in self.r2])) for name in self.r2[0]}

    @property
    def range(self) -> dict[str, tuple[float, float]]:
        """R2 by record, lowest and highest of the seeds."""
        return {name: (min(seed[name] for seed in self.r2), max(seed[name] for seed in self.r2)) for name in self.r2[0]}


@dataclass(frozen=True, kw_only=True)
class ProtocolSection:
    """Structures and records; details: free runs of the structures that have a model, the pick first; judgements:
    information criteria on the training data, by structure.
    """

    title: str
    about: str
    results: Sequence[StructureResult]
    details: Mapping[str, IdentificationSection] = field(default_factory=dict)
    judgements: Mapping[str, ModelCriteria] = field(default_factory=dict)

    @property
    def records(self) -> list[str]:
        """Names of the columns."""
        return list(self.results[0].r2[0])

    @property
    def pick(self) -> StructureResult | None:
        """The structure that was chosen."""
        return next((result for result in self.results if result.chosen), None)

    @property
    def display(self) -> Display:
        """The volts in which errors are shown."""
        return next(iter(self.details.values())).runs[0].display

    @property
    def horizons(self) -> list[HorizonErrors]:
        """Errors over the horizon of each structure that has free runs, over its records."""
        return [
            averaged(name, [run.horizons for run in section.runs])
            for name, section in self.details.items()
            if section.runs
        ]


def protocol_section(
    title: str,
    results: Sequence[StructureResult],
    *,
    about: str = "",
    training: Sequence[tuple[Record, Part]] = (),
) -> ProtocolSection:
    """Work out what a protocol's page shows: free runs, tests, horizons and loops of the structures with a model.

    training: what the models were fitted to; with it all of those that are scored at one period get information
    criteria, every weight of a network counted as a parameter.

    Raises:
        UserError: no structure, one without a seed or a record that others have, two of one name or two picks; a record
            that does not fit a model.
    """
    if not results:
        raise UserError(f"{title}: no structure to report")
    names = [result.name for result in results]
    if twins := {name for name in names if names.count(name) > 1}:
        raise UserError(f"{title}: two structures are called {min(twins)}; results go by the name")
    if sum(result.chosen for result in results) > 1:
        raise UserError(f"{title}: more than one structure is chosen")
    for result in results:
        if not result.r2 or any(list(seed) != list(results[0].r2[0]) for seed in result.r2):
            raise UserError(f"{title}: structure {result.name} has no seed, or other records than {names[0]}")
    details = {
        result.name: identification_section(result.model, result.runs)
        for result in sorted(results, key=lambda result: not result.chosen)
        if result.model is not None
    }
    models = {result.name: result.model for result in results if result.model is not None}
    return ProtocolSection(
        title=title, about=about, results=tuple(results), details=details, judgements=_judged(models, training)
    )


def _judged(models: Mapping[str, Model], training: Sequence[tuple[Record, Part]]) -> dict[str, ModelCriteria]:
    """Criteria of the models that are scored at the first one's period and don't diverge."""
    if not training or not models:
        return {}
    period = next(iter(models.values())).sampling.period
    residuals: dict[str, tuple[list[Array], int]] = {}
    for name, model in models.items():
        if model.sampling.period != period:
            continue
        experiments = [experiment_of(model, record, part=part) for record, part in training]
        errors = [item.outputs[:, 0] - free_run(model.system, item)[:, 0] for item in experiments]
        if all(np.isfinite(error).all() for error in errors):
            residuals[name] = (errors, model.free_numbers)
    return judge(residuals) if residuals else {}


def averaged(name: str, curves: Sequence[HorizonErrors]) -> HorizonErrors:
    """One curve for several records, at the horizons that all of them have: root mean squares of their errors, means of
    their R2.

    Raises:
        UserError: no curves, or no horizon that is common to all.
    """
    common = sorted(set.intersection(*(set(curve.horizons.tolist()) for curve in curves))) if curves else []
    if not common:
        raise UserError(f"{name}: the records have no common horizon to average over; give k_step_errors the horizons")
    chosen = [np.isin(curve.horizons, common) for curve in curves]
    limits = [curve.free_run for curve in curves]
    return HorizonErrors(
        name=name,
        horizons=np.array(common, dtype=np.int64),
        seconds=curves[0].seconds[chosen[0]],
        rmse=np.sqrt(np.mean([curve.rmse[c] ** 2 for curve, c in zip(curves, chosen, strict=True)], axis=0)),
        r2=np.mean([curve.r2[c] for curve, c in zip(curves, chosen, strict=True)], axis=0),
        rollouts=sum(curve.rollouts for curve in curves),
        free_run=Scores(
            r2=float(np.mean([scores.r2 for scores in limits])),
            rmse=float(np.sqrt(np.mean([scores.rmse**2 for scores in limits]))),
            fit_percent=float(np.mean([scores.fit_percent for scores in limits])),
        ),
    )
