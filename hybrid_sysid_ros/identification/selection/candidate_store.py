"""Finished candidates on disk, so that an interrupted comparison goes on where it was."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import asdict, astuple
from pathlib import Path

from hybrid_sysid_ros.identification.selection.blocks import Validation
from hybrid_sysid_ros.identification.selection.candidate import Candidate, Task
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder

CONTENT = "candidate.json"


class CandidateStore:
    """A folder for each finished candidate: its models and its scores. It is found again by all that it depends on:
    structure, seeds, samples of the records, parts, sampling and the versions of the libraries.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find(self, task: Task) -> Candidate | None:
        """The candidate of a task, None where it is not there or can't be read."""
        place = self._place(task)
        try:
            content = json.loads((place / CONTENT).read_text(encoding="utf-8"))
            return Candidate(
                structure=task.structure,
                models=[load(place / f"seed_{seed}") for seed in task.seeds],
                r2=content["r2"],
                validation=Validation(**content["validation"]),
                seconds=content["seconds"],
                kept=True,
            )
        except (OSError, ValueError, KeyError, TypeError, UserError):
            return None

    def keep(self, task: Task, candidate: Candidate) -> None:
        """Write a finished candidate; one that failed is tried again next time."""
        if candidate.validation is None:
            return
        content = {
            "r2": candidate.r2,
            "validation": asdict(candidate.validation),
            "seconds": candidate.seconds,
        }
        with written_folder(self._place(task), marker=CONTENT, force=True) as partial:
            for seed, model in zip(task.seeds, candidate.models, strict=True):
                model.save(partial / f"seed_{seed}")
            (partial / CONTENT).write_text(json.dumps(content), encoding="utf-8")

    def remove(self) -> None:
        """Remove the folder: the comparison is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _place(self, task: Task) -> Path:
        purpose = [
            task.structure,
            task.rig.name,
            [int(seed) for seed in task.seeds],
            astuple(task.sampling),
            [[record.fingerprint, astuple(task.part)] for record in task.training],
            [[record.name, record.fingerprint, astuple(part)] for record, part in task.tests],
            versions(),
        ]
        key = hashlib.sha256(json.dumps(purpose).encode()).hexdigest()[:16]
        return self.folder / f"{task.structure}-{key}"
