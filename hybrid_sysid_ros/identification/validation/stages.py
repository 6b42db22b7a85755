"""Stages of a model: residuals of each stage's free run, and whether they are random."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.experiment import ResampledRecord, resample
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation.residual_tests import LAGS, ResidualTest, independence, whiteness
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score
from hybrid_sysid_ros.models import Model


@dataclass(frozen=True, kw_only=True)
class StageResiduals:
    """Residuals of one output in the strict free run of a stage on one record."""

    record: str
    output: str
    stage: str
    """Name of the stage, such as "gray box" or "with its residual"."""
    scores: Scores
    whiteness: ResidualTest
    """Test of the residual's autocorrelation."""
    independence: ResidualTest
    """Test of the correlation with the first input."""

    @property
    def random(self) -> bool:
        """Whether past residuals and inputs explain nothing of the residual."""
        return self.whiteness.passed and self.independence.passed


def compare_stages(stages: Mapping[str, System], record: ResampledRecord) -> Iterator[StageResiduals]:
    """Residuals of each output for each stage of a model, see
    :meth:`~hybrid_sysid_ros.models.structure.Structure.stages`.

    Raises UserError for a record of other channels, a constant output, and too few samples to test.
    """
    lags = max(1, min(LAGS, (len(record.outputs) - 1) // 4))
    for stage, system in stages.items():
        experiment = record.experiment(system)
        simulated = free_run(system, experiment)
        errors = experiment.outputs - simulated
        for k, output in enumerate(system.outputs):
            yield StageResiduals(
                record=record.name,
                output=output.name,
                stage=stage,
                scores=score(experiment.outputs[:, k], simulated[:, k]),
                whiteness=whiteness(errors[:-1, k], lags=lags),
                independence=independence(errors[:-1, k], record.means[:-1, 0], lags=lags),
            )


def stages_of(model: Model, records: Iterable[tuple[Record, Part]]) -> tuple[StageResiduals, ...]:
    """Residuals of a model's stages on (parts of) records; empty where it has no stages.

    Raises UserError where a record does not fit the model's sampling.
    """
    stages, sampling = model.kind.stages(model.system), model.sampling
    parts = (resample(part.of(record, sampling), sampling) for record, part in records) if stages else ()
    return tuple(row for item in parts for row in compare_stages(stages, item))
