"""What a gray box leaves of its outputs, and what is left behind a model of that: whether it is random."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.experiment import Experiment
from hybrid_sysid_ros.identification.validation.residual_tests import LAGS, ResidualTest, independence, whiteness
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score
from hybrid_sysid_ros.models.residual import ResidualHybrid


@dataclass(frozen=True, kw_only=True)
class Leftovers:
    """Of one output in one record, in strict free run."""

    record: str
    output: str
    step: str
    """"gray box" or "with its residual"."""
    scores: Scores
    whiteness: ResidualTest
    """Of the residual with itself."""
    independence: ResidualTest
    """Of the residual with the first input."""

    @property
    def random(self) -> bool:
        """Whether nothing is left that the past of residual or input explains."""
        return self.whiteness.passed and self.independence.passed


def before_and_after(system: ResidualHybrid, experiment: Experiment) -> Iterator[Leftovers]:
    """Each output's residual under the gray box alone, and with what was learned beside it.

    experiment: prepared for the hybrid. Raises UserError for a constant output, and too few samples to test.
    """
    memory = system.record_map().delay_line
    first, count = memory.start, memory.stop
    own = [*range(first), *range(count, len(system.states))]
    alone = Experiment(
        name=experiment.name,
        sampling=experiment.sampling,
        inputs=experiment.inputs,
        outputs=experiment.outputs,
        states=experiment.states[:, own],
    )
    boxes: tuple[tuple[str, System, Experiment], ...] = (
        ("gray box", system.physics, alone),
        ("with its residual", system, experiment),
    )
    inputs = experiment.inputs.reshape(experiment.samples - 1, experiment.sampling.every, -1).mean(axis=1)
    lags = max(1, min(LAGS, (experiment.samples - 1) // 4))
    for step, box, prepared in boxes:
        simulated = free_run(box, prepared)
        errors = prepared.outputs - simulated
        for k, output in enumerate(system.outputs):
            yield Leftovers(
                record=experiment.name,
                output=output.name,
                step=step,
                scores=score(prepared.outputs[:, k], simulated[:, k]),
                whiteness=whiteness(errors[:-1, k], lags=lags),
                independence=independence(errors[:-1, k], inputs[:, 0], lags=lags),
            )
