"""Many calls of one exact MPC in compiled code: independent instances, and sequences of them.

Threads share nothing, since each has a horizon of its own, and each piece begins anew. So no digit depends on
their number.
"""

from __future__ import annotations

import math
import os
import queue
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel, instance_of
from hybrid_sysid_ros.control.mpc.limits import clamp_inputs
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.mpc.sequential import SolverResult
from hybrid_sysid_ros.control.mpc.shooting import CONVERGE, HorizonMemory, answer, plan_within, shift_trajectory
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

PIECE = 64
"""Rows that a thread solves between two looks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MpcAnswers(Shared):
    """Answers to instances: a row for each, n states, m inputs, horizon N."""

    inputs: Array
    """Plans within all limits, (rows, N, m); where there is no solution the rest of the last plan."""
    states: Array
    """Their predicted states, (rows, N + 1, n)."""
    solved: NDArray[np.bool_]
    """Whether the residual is within the tolerance, (rows,)."""
    iterations: NDArray[np.int64]
    """(rows,); 0 where there is no solution, or a part of the instance is not a number."""
    residuals: Array
    """(rows,)."""

    def __repr__(self) -> str:
        rows, horizon, _ = self.inputs.shape
        return f"MpcAnswers({np.count_nonzero(self.solved)} of {rows} solved, {horizon} intervals)"

    @classmethod
    def empty(cls, rows: int, horizon: int, states: int, inputs: int) -> MpcAnswers:
        """Room for some rows."""
        return cls(
            inputs=np.zeros((rows, horizon, inputs)),
            states=np.zeros((rows, horizon + 1, states)),
            solved=np.zeros(rows, np.bool_),
            iterations=np.zeros(rows, np.int64),
            residuals=np.zeros(rows),
        )


class Effort(NamedTuple):
    """What a call may take."""

    iterations: int
    tolerance: float
    attempts: int
    """Calls for one instance that is not solved, each from the answer before."""


@kernel
def answer_rows(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    effort: Effort,
    instances: Array,
    begins: NDArray[np.bool_],
    starts: Array,
    rows: tuple[int, int],
    answers: MpcAnswers,
) -> None:
    """Answer instances (rows, n + 2 m + N p) from .. to in turn; see :func:`answer_row`."""
    (n, m), count = horizon.linear.B.shape[1:], horizon.inputs.shape[0]
    flat = np.empty(instances.shape[1])
    instance = instance_of(flat, n, m, (instances.shape[1] - n - 2 * m) // count)
    cold = True
    for row in range(rows[0], rows[1]):
        assign(flat, instances[row])
        anew = begins[row] or row == rows[0]
        cold = answer_row(prediction, horizon, program, effort, instance, anew, cold, starts, answers, row)


@inner
def answer_row(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    effort: Effort,
    instance: Instance,
    begins: bool,
    cold: bool,
    starts: Array,
    answers: MpcAnswers,
    row: int,
) -> bool:
    """Answer an instance; return whether there still is no plan.

    A row that begins starts anew: from its inputs in ``starts`` (rows, N, m), or where that is empty from its previous
    inputs. The other rows start from the last plan, which is shifted by an interval.
    """
    if begins:
        quadratic.clear_working_set(program)
        cold = starts.shape[0] == 0
        if not cold:
            _start(horizon, instance, starts[row])
    cold = _answer(prediction, horizon, program, effort, instance, cold, answers, row)
    if not cold:
        shift_trajectory(prediction, horizon, 1.0)
    return cold


@inner
def _start(horizon: Horizon, instance: Instance, inputs: Array) -> None:
    """Take inputs (N, m) as the last plan; the solver finds their states."""
    assign_rows(inputs, horizon.inputs)
    clamp_inputs(horizon, instance.previous, horizon.inputs, True)
    for i in range(horizon.states.shape[0]):
        assign(horizon.states[i], instance.state)
    assign(horizon.disturbance, instance.disturbance)


@inner
def _answer(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    effort: Effort,
    instance: Instance,
    cold: bool,
    answers: MpcAnswers,
    row: int,
) -> bool:
    """Answer an instance as a call of the controller does; return whether there still is no plan."""
    found = SolverResult(False, 0, np.inf)
    for _ in range(effort.attempts):
        found = answer(
            prediction, horizon, program, instance, effort.iterations, effort.tolerance, cold, CONVERGE, True
        )
        cold = cold and found.iterations == 0
        if found.solved:
            break
    if cold:
        for i in range(horizon.inputs.shape[0]):
            for j in range(horizon.inputs.shape[1]):
                horizon.inputs[i, j] = math.nan  # the previous inputs take their place
            assign(horizon.states[i + 1], instance.state)
        assign(horizon.states[0], instance.state)
    if found.iterations == 0:
        plan_within(horizon, instance)
    assign_rows(horizon.planned, answers.inputs[row])
    assign_rows(horizon.states, answers.states[row])
    answers.solved[row] = found.solved
    answers.iterations[row] = found.iterations
    answers.residuals[row] = found.residual
    return cold


# ---------------------------------------------------------------------- threads


def in_threads(
    work: Callable[[HorizonMemory, Any], Any],
    items: Iterable[Any],
    memory: Callable[[], HorizonMemory],
    threads: int,
) -> Iterator[Any]:
    """Results of work in their order, each made with the memory of a thread. threads: 0 for one per core, which is also
    the most. Raises UserError for what is no such number.
    """
    if not isinstance(threads, int) or threads < 0:
        raise UserError(f"threads is {threads!r}; give a whole number from 1 on, or 0 for one per core")
    cores, found = os.cpu_count() or 1, list(items)
    count = max(1, min(threads or cores, cores, len(found)))
    free: queue.SimpleQueue[HorizonMemory] = queue.SimpleQueue()
    for _ in range(count):
        free.put(memory())

    def one(item: Any) -> Any:
        own = free.get()
        try:
            return work(own, item)
        finally:
            free.put(own)

    if count == 1:
        yield from map(one, found)
        return
    with ThreadPoolExecutor(count) as pool:
        yield from pool.map(one, found)
