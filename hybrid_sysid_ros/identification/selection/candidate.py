"""One structure put through all that a comparison asks of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.selection.blocks import Validation, cross_validate
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What one structure is to be put through: it goes to another process."""

    structure: str
    training: Sequence[Record]
    part: Part
    tests: Sequence[tuple[Record, Part]]
    rig: Rig
    sampling: Sampling
    seeds: Sequence[int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """One structure: models and r2 (test record -> R2), one for each seed; validation on the training data. error: why
    it has none of them, "" where it has. kept: it is of an earlier run.
    """

    structure: str
    models: Sequence[Model] = ()
    r2: Sequence[dict[str, float]] = ()
    validation: Validation | None = None
    seconds: float = 0.0
    error: str = ""
    kept: bool = False

    @property
    def parameters(self) -> int:
        """Free numbers of the fit, weights of a network included."""
        return self.models[0].free_numbers


def work(task: Task) -> Candidate:
    """One structure through all of its task."""
    began = time.perf_counter()
    try:
        shared: dict[str, Any] = {"sampling": task.sampling, "part": task.part}
        models = [identify(task.training, task.rig, task.structure, seed=seed, **shared) for seed in task.seeds]
        r2 = [{record.name: evaluate(model, record, part=part).r2 for record, part in task.tests} for model in models]
        validation = cross_validate(task.training, task.rig, task.structure, seed=task.seeds[0], **shared)
    except UserError as error:
        return Candidate(structure=task.structure, error=str(error))
    return Candidate(
        structure=task.structure, models=models, r2=r2, validation=validation, seconds=time.perf_counter() - began
    )
