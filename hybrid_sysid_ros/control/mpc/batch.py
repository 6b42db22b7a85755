"""Many calls of one exact MPC in compiled code: independent instances, sequences of them, and closed loops.

Threads share nothing, since each has a horizon of its own, and each row or loop begins anew. So no digit depends on
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
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, follow
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.mpc.sequential import SolverResult
from hybrid_sysid_ros.control.mpc.shooting import CONVERGE, HorizonMemory, answer, plan_within, shift_trajectory
from hybrid_sysid_ros.control.stage_cost import StageWeights
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


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopArrays(Shared):
    """A closed loop of T periods: what disturbs it, and its course. Without periods there is no loop."""

    initial_states: Array
    initial_inputs: Array
    references: Array
    disturbances: Array
    pushes: Array
    state_errors: Array
    disturbance_errors: Array
    input_errors: Array
    states: Array
    """(T + 1, n), before each period's push, and at the end."""
    inputs: Array
    """(T, m)."""
    costs: Array
    """(T,)."""
    excess: Array
    """(1,), largest distance of a state from its bounds."""

    @classmethod
    def empty(cls, periods: int, horizon: int, states: int, inputs: int, outputs: int) -> LoopArrays:
        """Room for a loop."""
        T, n, m = periods, states, inputs
        shapes = {
            "initial_states": (T, n),
            "initial_inputs": (T, m),
            "references": (T + horizon - 1, outputs),
            "disturbances": (T, m),
            "pushes": (T, n),
            "state_errors": (T, n),
            "disturbance_errors": (T, m),
            "input_errors": (T, m),
            "states": (T + 1, n),
            "inputs": (T, m),
            "costs": (T,),
            "excess": (1,),
        }
        return cls(**{name: np.zeros(shape) for name, shape in shapes.items()})

    @classmethod
    def none(cls) -> LoopArrays:
        """No loop."""
        own = {name: np.zeros((0, 0)) for name in cls.__annotations__}
        return cls(**own | {"costs": np.zeros(0), "excess": np.zeros(0)})


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
    plant: PredictionModel,
    weights: StageWeights,
    loop: LoopArrays,
) -> None:
    """Answer instances (rows, n + 2 m + N p) from .. to in turn.

    A row that begins starts anew: from its inputs in ``starts`` (rows, N, m), or where that is empty from its previous
    inputs. The other rows start from the last plan, which is shifted by an interval. In a loop the instances are those
    that the plant leads to, in the exact form, and are written; weights: those of one stage.
    """
    (n, m), count, driven = horizon.linear.B.shape[1:], horizon.inputs.shape[0], loop.inputs.shape[0] > 0
    p = (instances.shape[1] - n - 2 * m) // count
    flat, one = np.empty(instances.shape[1]), np.empty(n + 2 * m + p)
    instance, stage = instance_of(flat, n, m, p), instance_of(one, n, m, p)
    cold = True
    for row in range(rows[0], rows[1]):
        if driven:
            ask_controller(horizon, stage, loop, begins[row] or row == 0, row, instances[row])
        assign(flat, instances[row])
        if begins[row] or row == rows[0]:
            quadratic.clear_working_set(program)
            cold = starts.shape[0] == 0
            if not cold:
                _start(horizon, instance, starts[row])
        cold = _answer(prediction, horizon, program, effort, instance, cold, answers, row)
        if not cold:
            shift_trajectory(prediction, horizon, 1.0)
        if driven:
            advance_plant(plant, weights, stage, answers.inputs[row], loop, row)


@inner
def ask_controller(horizon: Horizon, stage: Instance, loop: LoopArrays, begins: bool, k: int, asked: Array) -> None:
    """Write the instance of period k for the controller, and that of the plant's ``stage`` without errors."""
    n, m, p = stage.state.shape[0], stage.previous.shape[0], stage.preview.shape[1]
    if begins:
        assign(stage.state, loop.initial_states[k])
        assign(stage.previous, loop.initial_inputs[k])
    assign(loop.states[k], stage.state)
    assign(stage.disturbance, loop.disturbances[k])
    assign(stage.preview[0], loop.references[k])
    for a in range(n):
        stage.state[a] += loop.pushes[k, a]
        asked[a] = stage.state[a] + loop.state_errors[k, a]
    for j in range(m):
        asked[n + j] = stage.disturbance[j] + loop.disturbance_errors[k, j]
        before = stage.previous[j] + loop.input_errors[k, j]
        asked[n + m + j] = min(max(before, horizon.limits.low[j]), horizon.limits.high[j])
    for i in range(horizon.inputs.shape[0]):
        for c in range(p):
            asked[n + 2 * m + i * p + c] = loop.references[k + i, c]


@inner
def advance_plant(
    plant: PredictionModel, weights: StageWeights, stage: Instance, inputs: Array, loop: LoopArrays, k: int
) -> None:
    """Advance the plant by period k under the first inputs of a plan."""
    n = stage.state.shape[0]
    path, applied = np.empty((2, n)), np.empty((1, inputs.shape[1]))
    assign(applied[0], inputs[0])
    loop.costs[k], excess = follow(plant, weights, stage, applied, path)
    assign(stage.state, path[1])
    assign(stage.previous, applied[0])
    assign(loop.inputs[k], applied[0])
    assign(loop.states[k + 1], path[1])
    for a in range(n):
        excess = excess if math.isfinite(path[1, a]) else np.inf
    loop.excess[0] = max(loop.excess[0], excess)


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
