"""Left out: free runs of training records by systems that were not fitted to them.

Errors of records that a fit has seen are smaller than those of others, and their offsets least of all, since parameters
bend to them. So each record, or block of few ones, is left out in turn, and the fit goes on without it for some
iterations: cross-validation, of which conformal prediction makes bands (Barber, Candes, Ramdas & Tibshirani 2021,
Annals of Statistics 49(1), the jackknife+).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from threadpoolctl import threadpool_limits

from hybrid_sysid_ros.core import Recurrence, System, rollouts
from hybrid_sysid_ros.identification.fitting import ANCHOR, COARSE, _solve
from hybrid_sysid_ros.identification.problem import FitProblem
from hybrid_sysid_ros.identification.standard_errors import BLOCKS
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support import threads
from hybrid_sysid_ros.support.arrays import Array

ITERATIONS = 6
"""Evaluations of each fit, which begins at that of all records."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LeftOut:
    """A block of a training record, and a system that was fitted without it."""

    record: int
    """Index of the record."""
    samples: slice
    system: System


def left_out(
    system: System, experiments: Sequence[PreparedRecord], deviations: Mapping[str, float], ridge: float
) -> list[LeftOut]:
    """Blocks that cover all records, at least BLOCKS in all; none for a system whose numbers no simulation fits.

    deviations: of the fitted parameters, of which each stays within ANCHOR. ridge: see :class:`~.problem.FitProblem`.
    """
    if isinstance(system, Recurrence):
        return _left_out_of_map(system, experiments)
    free = [item for item in system.parameters if item.name in deviations and not item.fixed]
    if not (free or len(system.weights)):
        return []
    problem = FitProblem(
        system,
        experiments,
        centres=np.array([system.named[item.name] for item in free]),
        spreads=np.array([ANCHOR * deviations[item.name] or np.inf for item in free]),
        ridge=ridge,
        hold=[item.name for item in system.parameters if item.name not in deviations],
    )
    outputs, found = len(system.outputs), []
    start = problem.with_hidden_starts(problem.start, None)
    with ThreadPoolExecutor(max_workers=threads.available()) as pool, threadpool_limits(1):
        for index, (item, edge) in enumerate(zip(experiments, problem.edges(None), strict=False)):
            begin = edge // outputs - problem.lead
            for first, last in _cuts(problem.lead, item.samples, len(experiments)):
                problem.without = slice((begin + first) * outputs, (begin + last) * outputs)
                fitted = problem.with_point(_solve(problem, None, start, (COARSE, ITERATIONS), pool.map).x)
                samples = slice(0 if first == problem.lead else first, last)
                found.append(LeftOut(record=index, samples=samples, system=fitted))
    return found


def _left_out_of_map(system: Recurrence, experiments: Sequence[PreparedRecord]) -> list[LeftOut]:
    """The same of a map from sample to sample, where it can go on with its fit."""
    found = []
    for index, item in enumerate(experiments):
        for first, last in _cuts(0, item.samples, len(experiments)):
            rest = [(each.inputs, each.outputs[: len(each.inputs)]) for k, each in enumerate(experiments) if k != index]
            rest += [(item.inputs[part], item.outputs[part]) for part in (slice(first), slice(last, len(item.inputs)))]
            fitted = system.fitted_again([part for part in rest if len(part[0]) > ITERATIONS], ITERATIONS)
            if fitted is None:
                return []
            found.append(LeftOut(record=index, samples=slice(first, last), system=fitted))
    return found


def _cuts(first: int, last: int, records: int) -> list[tuple[int, int]]:
    """First and last sample of each block of a record, of which there are some."""
    return list(pairwise(np.linspace(first, last, -(-BLOCKS // records) + 1).astype(int).tolist()))


def free_run_of(system: System, experiment: PreparedRecord, first: Array | None = None) -> Array:
    """The free run (samples, outputs) from a state (states,), by default from the start that the record decides."""
    sampling, starts = experiment.sampling, np.array([[0, 0, experiment.samples, 0]])
    state = initial_state(system, experiment) if first is None else first
    return rollouts(system, starts, state[None], experiment.inputs, step=sampling.step, every=sampling.every)[1]
