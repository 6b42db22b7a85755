"""Several structures on the same data: their scores, and the pick by training data only."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.extensions.shared.workers import Lost, count
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.structure import Options, structure_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.candidate import Candidate, FitTask, work

Report = Callable[[Candidate], object]
NEGLIGIBLE = 1e-5
"""R2 by which structures never differ, however well they are known: without noise a fit ends that far from the best."""
RULE = "the fewest parameters within one standard error of the best cross-validated R2"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """What became of each structure, and which is picked."""

    candidates: Sequence[Candidate]
    """In the order that was asked for."""
    chosen: str
    """The structure picked by training data only, "" for none."""
    seconds: float
    missing: Sequence[str] = ()
    """Structures that were asked for and not reached, in a comparison that was interrupted."""

    def model(self) -> Model:
        """The pick, fitted with the first seed; how it was picked is recorded in it."""
        candidate = next(item for item in self.candidates if item.structure == self.chosen)
        scores = {
            item.structure: {
                "r2": item.validation.value,
                "standard_error": item.validation.standard_error,
                "parameters": item.parameters,
            }
            for item in self.candidates
            if item.validation is not None
        }
        return replace(
            candidate.models[0], fit={**candidate.models[0].fit, "choice": {"rule": RULE, "structures": scores}}
        )


def compare(
    training: Sequence[Record],
    tests: Sequence[tuple[Record, Part]],
    rig: Rig,
    structures: Sequence[str],
    *,
    sampling: Sampling,
    part: Part | Sequence[Part] = Part(),
    alike: bool = False,
    options: Options | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    jobs: int = 0,
    store: Store[Candidate] | None = None,
    report: Report = lambda candidate: None,
) -> Comparison:
    """Fit structures with several seeds, score them on the tests, cross-validate them on the training data, and choose.

    part: of all training records, or of each. alike: of the blocks that are held out, see
    :func:`~hybrid_sysid_ros.extensions.search.cross_validation.cross_validate`. options: of all
    structures. jobs: processes, 0 for one a processor. report: gets each candidate as it is done. store: keeps finished
    candidates, and has those of an earlier run. A structure that can't be fitted, or whose process is killed again and
    again, is a candidate with an error; the others go on. The choice is the one-standard-error rule of Breiman et al.
    (1984): RULE, which the tests never enter.
    """
    began = time.perf_counter()
    bare = {id(record): replace(record, channels={}) for record in (*training, *(item for item, _ in tests))}
    tasks = [
        FitTask(
            structure=structure,
            training=[bare[id(record)] for record in training],
            part=part,
            alike=alike,
            tests=[(bare[id(record)], chosen) for record, chosen in tests],
            rig=rig,
            sampling=sampling,
            options=options or {},
            seeds=seeds if _seeded(structure, rig) else seeds[:1],
        )
        for structure in structures
    ]
    done: dict[str, Candidate] = {}
    slow_first = sorted(tasks, key=lambda task: len(task.seeds) == 1)
    found = parallel.workers_for(work, jobs=min(count(jobs), max(len(tasks), 1)), name=lambda task: task.structure)
    with found:
        for task, result, _ in parallel.resumed(
            found, slow_first, store=store, key=lambda task: task.key, keep=lambda item: item.validation is not None
        ):
            name = task.structure
            done[name] = Candidate(structure=name, error=result.reason) if isinstance(result, Lost) else result
            report(done[name])
    candidates = [done[structure] for structure in structures]
    return Comparison(candidates=candidates, chosen=choose(candidates), seconds=time.perf_counter() - began)


def _seeded(structure: str, rig: Rig) -> bool:
    try:
        return structure_of(structure, rig.system, rig.structures).seeded
    except UserError:  # its fit says what is wrong
        return False


def choose(candidates: Sequence[Candidate]) -> str:
    """The name of the pick by RULE, "" where no candidate was validated."""
    valid = [item for item in candidates if item.validation is not None and np.isfinite(item.validation.value)]
    if not valid:
        return ""
    values = {item.structure: item.validation for item in valid if item.validation is not None}
    best = max(values.values(), key=lambda item: item.value)
    least = best.value - max(best.standard_error, NEGLIGIBLE)
    within = [item for item in valid if values[item.structure].value >= least]
    return min(within, key=lambda item: (item.parameters, -values[item.structure].value)).structure
