"""Solved instances: an exact MPC does not solve again what another one has solved from the same plan.

The loops of a scenario are alike until the network drives, and beside a supervisor the judge solves what its own exact
MPC does. Solutions from other working sets differ by their rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.calls import FAILED, MpcMemory, adopt_plan, solve_instance
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array

PRIME = 1099511628211
"""Factor of the hash by Fowler, Noll and Vo."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedInstances(Shared):
    """What was solved, a row for each: n states, m inputs, horizon N."""

    count: NDArray[np.int64]
    """(1,), rows so far."""
    hashes: NDArray[np.int64]
    """(rows,), of the questions."""
    status: NDArray[np.int64]
    """(rows,)."""
    asked: Array
    """(rows, n + 2 m + N p + N m): the instance, and the last plan, NaN where there was none."""
    planned: Array
    """(rows, N, m)."""
    inputs: Array
    """(rows, N, m) of the trajectory from which the next call goes on."""
    states: Array
    """(rows, N + 1, n)."""
    constraints: NDArray[np.int32]
    """(rows, constraints): the working set, from which the next call goes on."""
    question: Array
    """A row of ``asked``."""

    @classmethod
    def empty(cls, rows: int, mpc: MpcMemory, instance: int) -> SolvedInstances:
        """Room for some rows; instance: its size."""
        horizon, constraints = mpc.horizon, len(mpc.program.states)
        return cls(
            count=np.zeros(1, np.int64),
            hashes=np.zeros(rows, np.int64),
            status=np.zeros(rows, np.int64),
            asked=np.zeros((rows, instance + horizon.inputs.size)),
            planned=np.zeros((rows, *horizon.inputs.shape)),
            inputs=np.zeros((rows, *horizon.inputs.shape)),
            states=np.zeros((rows, *horizon.states.shape)),
            constraints=np.zeros((rows, constraints), np.int32),
            question=np.zeros(instance + horizon.inputs.size),
        )


@inner
def solve_once(mpc: MpcMemory, instance: Instance, solved: SolvedInstances) -> None:
    """A call of the exact MPC, or the answer that was found before."""
    code = _ask_again(mpc, instance, solved)
    row = _find(solved, code)
    horizon, call, program = mpc.horizon, mpc.call[0], mpc.program
    if row < solved.count[0]:
        adopt_plan(mpc, instance.disturbance, solved.inputs[row], solved.states[row])
        assign_rows(solved.planned[row], horizon.planned)
        assign(program.states, solved.constraints[row])
        call.status = solved.status[row]
        return
    solve_instance(mpc, instance, mpc.iterations)
    if call.status == FAILED or row == solved.hashes.shape[0]:
        return
    solved.count[0] += 1
    solved.hashes[row], solved.status[row] = code, call.status
    assign(solved.asked[row], solved.question)
    assign_rows(horizon.planned, solved.planned[row])
    assign_rows(horizon.inputs, solved.inputs[row])
    assign_rows(horizon.states, solved.states[row])
    assign(solved.constraints[row], program.states)


@inner
def _ask_again(mpc: MpcMemory, instance: Instance, solved: SolvedInstances) -> int:
    """Write the question: the instance and the last plan; return its hash."""
    question, at, cold = solved.question, 0, mpc.call[0].cold != 0
    for part in (instance.state, instance.disturbance, instance.previous):
        for a in range(part.shape[0]):
            question[at + a] = part[a]
        at += part.shape[0]
    for rows in (instance.preview, mpc.horizon.inputs):
        for i in range(rows.shape[0]):
            for c in range(rows.shape[1]):
                question[at] = rows[i, c]
                at += 1
    count = mpc.horizon.inputs.size
    for a in range(at - count if cold else at, at):
        question[a] = np.nan
    code = np.int64(0)
    bits = question.view(np.int64)
    for a in range(at):
        code = (code ^ bits[a]) * PRIME
    return code


@inner
def _find(solved: SolvedInstances, code: int) -> int:
    """The row of the question, or the first free one."""
    question, asked = solved.question.view(np.int64), solved.asked.view(np.int64)
    for row in range(solved.count[0]):
        if solved.hashes[row] == code:
            same = True
            for a in range(question.shape[0]):
                same = same and question[a] == asked[row, a]
            if same:
                return row
    return solved.count[0]
