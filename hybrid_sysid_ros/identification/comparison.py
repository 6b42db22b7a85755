"""Several structures on the same data: their scores, and the pick by training data only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.identification import fitting
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation import Validation, cross_validate
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.structures import SEEDED
from hybrid_sysid_ros.record import Record
from hybrid_sysid_ros.rigs.rig import Rig

Told = Callable[["Candidate"], object]
RULE = "the fewest parameters within one standard error of the best cross-validated R2"


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
    it has none of them, "" where it has.
    """

    structure: str
    models: Sequence[Model] = ()
    r2: Sequence[dict[str, float]] = ()
    validation: Validation | None = None
    seconds: float = 0.0
    error: str = ""

    @property
    def parameters(self) -> int:
        """Free numbers of the fit, weights of a network included."""
        return self.models[0].free_numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """candidates in the order that was asked for; chosen: the structure picked by training data only, "" for none."""

    candidates: Sequence[Candidate]
    chosen: str
    seconds: float

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
    part: Part = Part(),
    seeds: Sequence[int] = (0, 1, 2),
    jobs: int = 0,
    told: Told = lambda candidate: None,
) -> Comparison:
    """Fit structures with several seeds, score them on the tests, cross-validate them on the training data, and choose.

    jobs: processes, 0 for one a processor. told: gets each candidate as it is done. A structure that can't be fitted is
    a candidate with an error; the others go on. The choice is the one-standard-error rule of Breiman et al. (1984):
    RULE, which the tests never enter.
    """
    began = time.perf_counter()
    bare = {id(record): replace(record, channels={}) for record in (*training, *(item for item, _ in tests))}
    tasks = [
        Task(
            structure=structure,
            training=[bare[id(record)] for record in training],
            part=part,
            tests=[(bare[id(record)], chosen) for record, chosen in tests],
            rig=rig,
            sampling=sampling,
            seeds=seeds if structure in SEEDED else seeds[:1],
        )
        for structure in structures
    ]
    done = {}
    for candidate in _run(tasks, jobs or os.cpu_count() or 1):
        done[candidate.structure] = candidate
        told(candidate)
    candidates = [done[structure] for structure in structures]
    return Comparison(candidates=candidates, chosen=choose(candidates), seconds=time.perf_counter() - began)


def choose(candidates: Sequence[Candidate]) -> str:
    """The name of the pick by RULE, "" where no candidate was validated."""
    valid = [item for item in candidates if item.validation is not None and np.isfinite(item.validation.value)]
    if not valid:
        return ""
    values = {item.structure: item.validation for item in valid if item.validation is not None}
    best = max(values.values(), key=lambda item: item.value)
    within = [item for item in valid if values[item.structure].value >= best.value - best.standard_error]
    return min(within, key=lambda item: (item.parameters, -values[item.structure].value)).structure


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


def _run(tasks: Sequence[Task], jobs: int) -> Iterator[Candidate]:
    """Candidates as they are done; the slow structures begin first."""
    slow_first = sorted(tasks, key=lambda task: task.structure not in SEEDED)
    if jobs == 1:
        yield from map(work, slow_first)
        return
    # Ctrl-C is for the parent, which ends the others.
    ignore = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(max_workers=min(jobs, len(tasks)), mp_context=context, initializer=ignore)
    try:
        running: dict[Future[Candidate], str] = {pool.submit(_work_alone, task): task.structure for task in slow_first}
        for future in as_completed(running):
            try:
                yield future.result()
            except BrokenProcessPool:
                yield Candidate(structure=running[future], error="its process was killed; run again, or with --jobs 1")
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _work_alone(task: Task) -> Candidate:
    """As a process beside others does it."""
    with fitting.alone():
        return work(task)
