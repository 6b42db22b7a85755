"""Stages of a model: residuals of each stage's free run, and whether they are random."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.residual_tests import LAGS, ResidualTest, independence, whiteness
from hybrid_sysid_ros.identification.experiment import ResampledRecord, resample
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import FurtherSection, Inspection
from hybrid_sysid_ros.rigs.rig import Rig


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


def stages() -> Callable[[Model, Sequence[tuple[Record, Part]], Rig], Inspection | None]:
    """An inspection of a model's stages over (parts of) records: None where it has no stages.

    It raises UserError where a record does not fit the model's sampling.
    """

    def inspect(model: Model, records: Sequence[tuple[Record, Part]], rig: Rig) -> Inspection | None:
        parts, sampling = model.kind.stages(model.system), model.sampling
        if not parts:
            return None
        found = [
            row
            for record, part in records
            for row in compare_stages(parts, resample(part.of(record, sampling), sampling))
        ]
        return Inspection(name="stages", section=_section(found))

    return inspect


def _section(found: Sequence[StageResiduals]) -> FurtherSection:
    rows = [
        (
            *(row.record, row.output, row.stage, f"{row.scores.r2:.4f}"),
            *(f"{test.outside} of {len(test.lags)}" for test in (row.whiteness, row.independence)),
            "yes" if row.random else "no",
        )
        for row in sorted(found, key=lambda row: (row.record, row.output))
    ]
    return FurtherSection(
        title="Stages of the model: whether the residual of each free run is random (99 % bounds)",
        text="The model in its stages, such as a gray box and the same with a model of its residual beside it. For "
        "each: how many of the correlation coefficients of what is left in free run lie outside of their 99 % bounds.",
        headings=("record", "output", "free run of", "R2", "lags outside: itself", "input", "random"),
        rows=rows,
    )
