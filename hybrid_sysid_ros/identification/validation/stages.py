"""Stages of a model: what the free run of each leaves of a record, and whether that is random."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.experiment import ResampledRecord
from hybrid_sysid_ros.identification.validation.residual_tests import LAGS, ResidualTest, independence, whiteness
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score


@dataclass(frozen=True, kw_only=True)
class StageResiduals:
    """Of one output in one record, in strict free run."""

    record: str
    output: str
    stage: str
    """Such as "gray box" and "with its residual"."""
    scores: Scores
    whiteness: ResidualTest
    """Of the residual with itself."""
    independence: ResidualTest
    """Of the residual with the first input."""

    @property
    def random(self) -> bool:
        """Whether nothing is left that the past of residual or input explains."""
        return self.whiteness.passed and self.independence.passed


def compare_stages(stages: Mapping[str, System], record: ResampledRecord) -> Iterator[StageResiduals]:
    """Each output's residual in the free run of each stage of a model, see
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
