"""One structure put through all that a comparison asks of it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.search.cross_validation import Validation, cross_validate
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.models import Model, Sampling, load
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.models.structure import Options
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

CONTENT = "candidate.json"


@dataclass(frozen=True, kw_only=True, eq=False)
class FitTask:
    """What one structure is to be put through: it goes to another process."""

    structure: str
    training: Sequence[Record]
    part: Part | Sequence[Part]
    alike: bool
    tests: Sequence[tuple[Record, Part]]
    rig: Rig
    sampling: Sampling
    seeds: Sequence[int]
    options: Options = field(default_factory=dict)
    """Of the structure."""

    @property
    def parts(self) -> Sequence[Part]:
        """Of each training record."""
        return [self.part] * len(self.training) if isinstance(self.part, Part) else self.part

    @property
    def key(self) -> list[Any]:
        """All that its results depend on, versions of the libraries included."""
        return [
            self.structure,
            self.rig.source,
            sorted(self.options.items()),
            [int(seed) for seed in self.seeds],
            list(astuple(self.sampling)),
            [[record.fingerprint, *astuple(part)] for record, part in zip(self.training, self.parts, strict=True)],
            self.alike,
            [[record.name, record.fingerprint, *astuple(part)] for record, part in self.tests],
            versions(),
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """What became of one structure."""

    structure: str
    models: Sequence[Model] = ()
    """One for each seed."""
    r2: Sequence[dict[str, float]] = ()
    """Test record -> R2, for each seed."""
    validation: Validation | None = None
    """On the training data."""
    seconds: float = 0.0
    error: str = ""
    """Why it has none of them, "" where it has."""
    kept: bool = False
    """It is of an earlier run."""

    @property
    def parameters(self) -> int:
        """Free numbers of the fit, weights of a network included."""
        return self.models[0].free_numbers


def work(task: FitTask) -> Candidate:
    """One structure through all of its task."""
    began = time.perf_counter()
    try:
        shared: dict[str, Any] = {"sampling": task.sampling, "part": task.part, "options": task.options}
        models = [identify(task.training, task.rig, task.structure, seed=seed, **shared) for seed in task.seeds]
        held: dict[str, Any] = {"seed": task.seeds[0], "alike": task.alike}
        validation = cross_validate(task.training, task.rig, task.structure, **held, **shared)
    except UserError as error:
        return Candidate(structure=task.structure, error=str(error))
    r2 = [{record.name: _tested(model, record, part) for record, part in task.tests} for model in models]
    return Candidate(
        structure=task.structure, models=models, r2=r2, validation=validation, seconds=time.perf_counter() - began
    )


def _tested(model: Model, record: Record, part: Part) -> float:
    """R2 on a test; minus infinity where it can't be simulated, for a test has no say in which candidates there are."""
    try:
        return evaluate(model, record, part=part).r2
    except UserError:
        return -math.inf


class CandidateStore(Store[Candidate]):
    """Where finished candidates are kept: their models and their scores."""

    def write(self, result: Candidate, folder: Path) -> None:
        assert result.validation is not None
        for number, model in enumerate(result.models):
            model.save(folder / f"model_{number}")
        content = {
            "structure": result.structure,
            "models": len(result.models),
            "r2": result.r2,
            "validation": asdict(result.validation),
            "seconds": result.seconds,
        }
        (folder / CONTENT).write_text(json.dumps(content), encoding="utf-8")

    def read(self, folder: Path) -> Candidate:
        content = json.loads((folder / CONTENT).read_text(encoding="utf-8"))
        return Candidate(
            structure=content["structure"],
            models=[load(folder / f"model_{number}") for number in range(content["models"])],
            r2=content["r2"],
            validation=Validation(**content["validation"]),
            seconds=content["seconds"],
            kept=True,
        )
