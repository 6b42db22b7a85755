"""Several structures on the same data: their scores, and the pick by training data only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import fitting
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.selection.candidate import Candidate, Task, work
from hybrid_sysid_ros.identification.selection.candidate_store import CandidateStore
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.structures import SEEDED
from hybrid_sysid_ros.rigs.rig import Rig

Told = Callable[[Candidate], object]
LOSSES = 2
LOST = f"its process was killed {LOSSES} times; perhaps it needs more memory: run again with --jobs 1"
RULE = "the fewest parameters within one standard error of the best cross-validated R2"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """candidates in the order that was asked for; chosen: the structure picked by training data only, "" for none.
    missing: structures that were asked for and not reached, in a comparison that was interrupted.
    """

    candidates: Sequence[Candidate]
    chosen: str
    seconds: float
    missing: Sequence[str] = ()

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
    store: CandidateStore | None = None,
    told: Told = lambda candidate: None,
) -> Comparison:
    """Fit structures with several seeds, score them on the tests, cross-validate them on the training data, and choose.

    jobs: processes, 0 for one a processor. told: gets each candidate as it is done. store: keeps finished candidates,
    and has those of an earlier run. A structure that can't be fitted, or whose process is killed LOSSES times, is a
    candidate with an error; the others go on. The choice is the one-standard-error rule of Breiman et al. (1984):
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
    known = [store.find(task) for task in tasks] if store is not None else []
    done = {candidate.structure: candidate for candidate in known if candidate is not None}
    for candidate in done.values():
        told(candidate)
    left = {task.structure: task for task in tasks if task.structure not in done}
    with closing(_run(list(left.values()), jobs or os.cpu_count() or 1)) as running:
        for candidate in running:
            done[candidate.structure] = candidate
            if store is not None:
                store.keep(left[candidate.structure], candidate)
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


def _run(tasks: Sequence[Task], jobs: int) -> Generator[Candidate, None, None]:
    """Candidates as they are done; the slow structures begin first. Each process is a pool of its own, which breaks
    alone when it is killed.
    """
    waiting = deque(sorted(tasks, key=lambda task: task.structure not in SEEDED))
    if jobs == 1:
        yield from map(work, waiting)
        return
    idle = [_process() for _ in range(min(jobs, len(tasks)))]
    running: dict[Future[Candidate], tuple[ProcessPoolExecutor, Task]] = {}
    losses: Counter[str] = Counter()
    try:
        while waiting or running:
            while waiting and idle:
                process, task = idle.pop(), waiting.popleft()
                running[process.submit(_work_alone, task)] = process, task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                process, task = running.pop(future)
                try:
                    candidate = future.result()
                    idle.append(process)
                except BrokenProcessPool:
                    idle.append(_process())
                    losses[task.structure] += 1
                    if losses[task.structure] < LOSSES:
                        waiting.appendleft(task)
                        continue
                    candidate = Candidate(structure=task.structure, error=LOST)
                yield candidate
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        for process in (*idle, *(process for process, _ in running.values())):
            process.shutdown(wait=False, cancel_futures=True)


def _process() -> ProcessPoolExecutor:
    # Ctrl-C is for the parent, which ends the others.
    ignore = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(max_workers=1, mp_context=context, initializer=ignore)


def _work_alone(task: Task) -> Candidate:
    """As a process beside others does it."""
    with fitting.alone():
        return work(task)
